//! Parts of another colour than the floor but as bright: a plane of grey values in which they stand out.
//!
//! Takes a raw [`Frame`] in colour, and what colours parts and floor have in it; gives a grey frame that [`HuePlane`] owns. What is measured in grey values (ends,
//! outlines) is measured in luma, which cameras send in full resolution and with the least noise; red wire on a green floor has
//! none to show. Its colour is then held against the floor's: of the way from the floor's mean colour to the parts', that which is
//! across the floor's own, so that shadows and light that falls off leave a floor as it is.
//!
//! ```
//! use pickcell::frame::Frame;
//! use pickcell::vision::hue::{Colours, HuePlane};
//!
//! let (red, green) = ([200, 70, 110], [70, 144, 60]);
//! let colours = Colours { parts: red.map(f64::from).into(), floor: green.map(f64::from).into() };
//! assert!(colours.luma_contrast().abs() < 10.0 && colours.hue_contrast() > 100.0);
//!
//! let frame = Frame::from_rgb(3, 1, [green, green.map(|v| v / 2), red].concat());
//! let plane = HuePlane::new(3, 1).run(&frame, frame.encoding, &colours).clone();
//! assert_eq!(plane.bytes, [64, 64, 192]); // shadow is floor
//! ```

use nalgebra::{Vector2, Vector3};

use super::beside::Beside;
use super::bits::nearest;
use super::halve::in_whole;
use crate::frame::colour::{LUMA_SHIFT, LUMA_WEIGHTS};
use crate::frame::{ColourEncoding, Frame, PixelFormat, RgbView};

/// Grey values of the floor's mean colour, and of the parts'.
const FLOOR: f64 = 64.0;
const PARTS: f64 = 192.0;
/// Places on wire, and as many beside it, that tell colours.
const PLACES_MIN: usize = 12;
/// A floor darker than this, in R, G, B together, has no colour of its own.
const BLACK: f64 = 24.0;
/// Least contrast in which luma serves, and colours do, in grey levels; and how many times as much as luma's theirs must be.
const LUMA_ENOUGH: f64 = 40.0;
const HUE_MIN: f64 = 30.0;
const HUE_RATIO: f64 = 2.0;
/// What is less is rounding, in levels.
const HUE_LEAST: f64 = 1.0;

/// The mean colours of a picture: R, G, B from 0 to 255.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Colours {
    /// Of the object.
    pub parts: Vector3<f64>,
    /// Of the floor beside it.
    pub floor: Vector3<f64>,
}

impl Colours {
    /// The mean colours at these places of a frame, which were found when it had been halved so many times; `None` where there
    /// are hardly any.
    pub fn at(places: impl Iterator<Item = Beside>, frame: &RgbView, halvings: usize) -> Option<Self> {
        let colour_at = |px: Vector2<f64>| {
            let [x, y] = in_whole(px, halvings).into();
            // What lies outside takes the border's.
            Vector3::from(frame.at(nearest(x).max(0) as usize, nearest(y).max(0) as usize)).map(f64::from)
        };
        let ([mut parts, mut floor], mut count) = ([Vector3::zeros(); 2], 0);
        for Beside { wire_px, floor_px } in places {
            parts += wire_px.map(colour_at).iter().sum::<Vector3<f64>>() / wire_px.len() as f64;
            floor += colour_at(floor_px);
            count += 1;
        }
        let mean = |sum: Vector3<f64>| sum / count as f64;
        (count >= PLACES_MIN).then(|| Self { parts: mean(parts), floor: mean(floor) })
    }

    /// By how many grey levels the parts are brighter than the floor.
    pub fn luma_contrast(&self) -> f64 {
        let weights = Vector3::from(LUMA_WEIGHTS).map(f64::from) / f64::from(1 << LUMA_SHIFT);
        weights.dot(&(self.parts - self.floor))
    }

    /// How far the parts' colour is from the floor's, in levels, across the floor's own: what differs but in brightness is 0.
    pub fn hue_contrast(&self) -> f64 {
        self.across().norm()
    }

    /// Whether grey values tell parts from the floor better by colour than by luma.
    pub fn tell_more_than_luma(&self) -> bool {
        let (luma, hue) = (self.luma_contrast().abs(), self.hue_contrast());
        luma < LUMA_ENOUGH && hue >= HUE_MIN && hue >= HUE_RATIO * luma
    }

    fn across(&self) -> Vector3<f64> {
        let way = self.parts - self.floor;
        match self.floor.try_normalize(BLACK) {
            Some(floor) => way - floor * floor.dot(&way),
            None => way,
        }
    }
}

/// The stage: owns the plane.
#[derive(Clone, Debug)]
pub struct HuePlane {
    plane: Frame,
}

impl HuePlane {
    /// Allocates for pictures of this size in pixels.
    pub fn new(width: usize, height: usize) -> Self {
        Self { plane: Frame::from_grey(width, height, vec![0; width * height]) }
    }

    /// The grey values of `frame` in which parts and floor of these colours differ most: 64 is the floor's colour and 192 the
    /// parts'. All are 64 where they hardly differ but in brightness, or the frame is compressed, short or of another size.
    pub fn run(&mut self, frame: &Frame, encoding: ColourEncoding, colours: &Colours) -> &Frame {
        let across = colours.across();
        let scale = (PARTS - FLOOR) / across.norm_squared();
        let weights = (across * scale).map(|w| w as f32);
        let offset = (0.5 + FLOOR - colours.floor.dot(&across) * scale) as f32;
        let Self { plane } = self;
        let is_of_size = (frame.width, frame.height) == (plane.width, plane.height);
        let pixels =
            RgbView::with_encoding(frame, encoding).filter(|_| is_of_size && across.norm() >= HUE_LEAST);
        let Some(pixels) = pixels else {
            plane.bytes.fill(FLOOR as u8);
            return plane;
        };
        // Rounded; what is out of range saturates.
        let grey = |[r, g, b]: [u8; 3]| {
            (offset + weights.x * f32::from(r) + weights.y * f32::from(g) + weights.z * f32::from(b)) as u8
        };
        let rows = plane.bytes.chunks_exact_mut(plane.width).enumerate();
        if frame.format == PixelFormat::Rgb {
            for ((_, out), row) in rows.zip(frame.bytes.chunks(frame.stride_bytes)) {
                out.iter_mut().zip(row.as_chunks().0).for_each(|(out, rgb)| *out = grey(*rgb));
            }
        } else {
            for (y, out) in rows {
                out.iter_mut().enumerate().for_each(|(x, out)| *out = grey(pixels.at(x, y)));
            }
        }
        plane
    }

    /// The plane of the last run.
    pub fn plane(&self) -> &Frame {
        &self.plane
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::QuantizationRange;

    const SIZE: [usize; 2] = [64, 40];

    /// A wire of one colour, six rows thick, on a floor of another that lies in shadow on the left; and places along it.
    fn picture(floor: [u8; 3], wire: [u8; 3], format: PixelFormat) -> (Frame, Vec<Beside>) {
        let [width, height] = SIZE;
        let colour_at = |x: usize, y: usize| match ((17..23).contains(&y), x < 32) {
            (true, _) => wire,
            (false, true) => floor.map(|v| v / 2),
            (false, false) => floor,
        };
        let yuv = |rgb: [u8; 3]| {
            let [r, g, b] = rgb.map(f64::from);
            let y = 0.299 * r + 0.587 * g + 0.114 * b;
            [y, 128.0 + (b - y) / 1.772, 128.0 + (r - y) / 1.402].map(|v| v.round() as u8)
        };
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let bytes = pixels.flat_map(|(x, y)| match (format, colour_at(x, y)) {
            (PixelFormat::Bgr, [r, g, b]) => vec![b, g, r],
            (PixelFormat::Yuyv, rgb) => vec![yuv(rgb)[0], yuv(rgb)[1 + x % 2]],
            (_, rgb) => rgb.to_vec(),
        });
        let bytes: Vec<u8> = bytes.collect();
        let encoding = ColourEncoding { range: QuantizationRange::Full, ..ColourEncoding::default() };
        let stride_bytes = bytes.len() / height;
        let places = (2..62).map(|x| Beside {
            wire_px: [18.0, 20.0, 22.0].map(|y| Vector2::new(f64::from(x), y)),
            floor_px: Vector2::new(f64::from(x), if x % 2 == 0 { 13.0 } else { 26.0 }),
        });
        let frame = Frame { bytes, format, width, height, stride_bytes, encoding, ..Frame::default() };
        (frame, places.collect())
    }

    fn colours(frame: &Frame, places: &[Beside]) -> Option<Colours> {
        Colours::at(places.iter().copied(), &RgbView::with_encoding(frame, frame.encoding)?, 0)
    }

    #[test]
    fn colours_stand_out_in_every_format_and_shadows_do_not() {
        for format in [PixelFormat::Rgb, PixelFormat::Bgr, PixelFormat::Yuyv] {
            let (frame, places) = picture([60, 130, 80], [190, 60, 110], format);
            let colours = colours(&frame, &places).expect("wire and floor");
            let mut stage = HuePlane::new(SIZE[0], SIZE[1]);
            assert!(colours.tell_more_than_luma(), "{format:?} {colours:?}");
            let plane = stage.run(&frame, frame.encoding, &colours);
            for x in [10, 50] {
                let seen = [5, 20, 35].map(|y| i32::from(plane.luma(x, y)));
                assert!(
                    seen.iter().zip([64, 192, 64]).all(|(a, b)| (a - b).abs() <= 2),
                    "{format:?} {seen:?}"
                );
            }
        }
    }

    #[test]
    fn luma_serves_where_it_tells_parts_from_the_floor() {
        let tell = |floor, wire| {
            let (frame, places) = picture(floor, wire, PixelFormat::Rgb);
            colours(&frame, &places).map(|colours| colours.tell_more_than_luma())
        };
        assert_eq!(tell([40, 40, 40], [190, 190, 190]), Some(false), "grey");
        assert_eq!(tell([40, 40, 40], [210, 90, 60]), Some(false), "bright and red");
        assert_eq!(tell([90, 90, 90], [110, 110, 112]), Some(false), "hardly any difference");
        let (frame, _) = picture([9; 3], [9; 3], PixelFormat::Rgb);
        assert_eq!(colours(&frame, &[]), None, "no wire");
    }

    #[test]
    fn a_plane_of_no_colours_is_all_floor() {
        let (frame, _) = picture([50; 3], [100; 3], PixelFormat::Rgb);
        let none = Colours { parts: Vector3::repeat(100.0), floor: Vector3::repeat(50.0) };
        let mut stage = HuePlane::new(SIZE[0], SIZE[1]);
        assert!(stage.run(&frame, frame.encoding, &none).bytes.iter().all(|&v| v == 64));
        let short = Frame { bytes: vec![0; 9], ..frame };
        let red = Colours { parts: Vector3::new(200.0, 50.0, 50.0), ..none };
        assert!(stage.run(&short, short.encoding, &red).bytes.iter().all(|&v| v == 64));
    }
}
