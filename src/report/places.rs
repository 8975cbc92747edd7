//! Where labels stand in a picture: beside what they name, and on nothing else that is to be read.

use nalgebra::Vector2;

/// Pictures of this width have lines and letters of single width; wider ones so much more.
const SINGLE_WIDTH_PX: usize = 640;
/// How many of its heights a label stands lower than it would best, in the order of trying.
const LOWER: [f64; 11] = [0.0, 1.0, -1.0, 2.0, -2.0, 3.0, -3.0, 4.0, -4.0, 5.0, -5.0];

/// How many times as wide as single lines and letters those of a picture are.
pub(super) fn scale_of(width_px: usize) -> usize {
    (width_px / SINGLE_WIDTH_PX).max(1)
}

/// A box: its upper left and lower right corner.
type Area = [Vector2<f64>; 2];

/// What of a picture is taken.
pub(super) struct Places {
    picture: Area,
    taken: Vec<Area>,
    lines: Vec<Vector2<f64>>,
}

impl Places {
    /// All of this box is free.
    pub(super) fn new(low: Vector2<f64>, high: Vector2<f64>) -> Self {
        Self { picture: [low, high], taken: Vec::new(), lines: Vec::new() }
    }

    /// No label is to stand between these points, if it can be helped.
    pub(super) fn take(&mut self, from: Vector2<f64>, to: Vector2<f64>) {
        self.taken.push([from.inf(&to), from.sup(&to)]);
    }

    /// This point of a line is better seen than not.
    pub(super) fn show(&mut self, point: Vector2<f64>) {
        self.lines.push(point);
    }

    /// The upper left corner of a label of this size, `gap` beside and above a point, or as near to that as there is room and it
    /// hides least of the lines; it is taken then.
    pub(super) fn beside(
        &mut self,
        point: Vector2<f64>,
        gap: Vector2<f64>,
        size: Vector2<f64>,
    ) -> Vector2<f64> {
        let [low, high] = self.picture;
        let sides = [gap.x, -gap.x - size.x];
        let corners = LOWER.iter().flat_map(|k| sides.map(|x| point + Vector2::new(x, k * size.y - gap.y)));
        let inside = corners.map(|corner| corner.inf(&(high - size)).sup(&low));
        let is_free =
            |corner: &Vector2<f64>| !self.taken.iter().any(|t| overlap(&[*corner, corner + size], t));
        let best = inside.clone().next().unwrap_or(point);
        let hidden = |corner: &Vector2<f64>| {
            self.lines.iter().filter(|point| overlap(&[*corner, corner + size], &[**point, **point])).count()
        };
        let corner = inside.filter(is_free).min_by_key(hidden).unwrap_or(best);
        self.take(corner, corner + size);
        corner
    }
}

/// Whether two boxes share anything.
fn overlap(a: &Area, b: &Area) -> bool {
    [0, 1].into_iter().all(|k| a[0][k] < b[1][k] && b[0][k] < a[1][k])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_stand_apart_and_inside() {
        let v = |x: f64, y: f64| Vector2::new(x, y);
        let (gap, size) = (v(5.0, 10.0), v(40.0, 10.0));
        let mut places = Places::new(v(0.0, 0.0), v(200.0, 100.0));
        assert_eq!(places.beside(v(50.0, 50.0), gap, size), v(55.0, 40.0));
        // The same place again: at the other side.
        assert_eq!(places.beside(v(50.0, 50.0), gap, size), v(5.0, 40.0));
        places.take(v(200.0, 59.0), v(0.0, 50.0));
        // Below lies something, above there is room.
        assert_eq!(places.beside(v(50.0, 50.0), gap, size), v(55.0, 30.0));
        // And beside it, where nothing lies, a line would be hidden.
        let mut lined = Places::new(v(0.0, 0.0), v(200.0, 100.0));
        lined.show(v(70.0, 45.0));
        assert_eq!(lined.beside(v(50.0, 50.0), gap, size), v(5.0, 40.0));
        let corner = places.beside(v(199.0, 2.0), gap, size);
        assert_eq!(corner, v(160.0, 0.0));
        // No room at all is no reason to say nothing.
        places.take(v(-9.0, -9.0), v(300.0, 300.0));
        assert_eq!(places.beside(v(50.0, 50.0), gap, size), v(55.0, 40.0));
    }

    #[test]
    fn lines_are_wider_in_wider_pictures() {
        assert_eq!([320, 640, 1279, 1280, 1920, 3840].map(scale_of), [1, 1, 1, 2, 3, 6]);
    }
}
