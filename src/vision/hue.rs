//! Parts of another colour than the floor but as bright: a plane of grey values in which they stand out.
//!
//! Takes a raw [`Frame`] in colour, and what colours parts and floor have in it; gives a grey frame that [`HuePlane`] owns. What is
//! measured in grey values (ends, outlines) is measured in luma, which cameras send in full resolution and with the least noise; red wire on a green floor has
//! none to show. Its colour is then held against the floor's: of the way from the floor's colour to the parts', that which is
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
use super::luma::CLOCK_ROWS;
use crate::frame::colour::{LUMA_SHIFT, LUMA_WEIGHTS};
use crate::frame::{ColourEncoding, Frame, PixelFormat, RgbView};
use crate::time::Timestamp;

/// Grey values of the floor's colour, and of the parts'.
const FLOOR: f64 = 64.0;
const PARTS: f64 = 192.0;
/// What differs by less, in levels, differs by rounding.
const ROUNDING: f64 = 1.0;
/// Places on wire, and as many beside it, that tell colours.
const PLACES_MIN: usize = 12;
/// A floor darker than this, in R, G, B together, has no colour of its own.
const BLACK: f64 = 24.0;
/// Contrasts in grey levels: in which luma shows next to nothing, and in which it serves with bright parts; in which colours serve
/// with the first; and with bright and dark parts, and then how many times as much as luma's. Dark parts have shadows, which have
/// no colour; of bright parts cameras send luma in more detail.
const LUMA_LEAST: f64 = 12.0;
const LUMA_ENOUGH: f64 = 40.0;
const HUE_LEAST: f64 = 18.0;
const HUE_OF_BRIGHT: [f64; 2] = [30.0, 2.0];
const HUE_OF_DARK: [f64; 2] = [60.0, 0.75];
/// Gloss: from so many levels brighter than parts and floor on, to so many more, what is seen is taken for the parts' colour.
const GLOSS: [f64; 2] = [25.0, 40.0];

/// The colours of a picture, medians of R, G and B from 0 to 255.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Colours {
    /// Of the object.
    pub parts: Vector3<f64>,
    /// Of the floor beside it.
    pub floor: Vector3<f64>,
}

impl Colours {
    /// The colours at these places of a frame, which were found when it had been halved so many times; `None` where there are
    /// hardly any.
    pub fn at(places: &[Beside], frame: &RgbView, halvings: usize) -> Option<Self> {
        let colour_at = |px: Vector2<f64>| {
            let [x, y] = in_whole(px, halvings).into();
            // What lies outside takes the border's.
            frame.at(nearest(x).max(0) as usize, nearest(y).max(0) as usize)
        };
        let [mut parts, mut floor] = [Levels::NONE; 2];
        for Beside { wire_px, floor_px } in places {
            let wire = wire_px.map(colour_at);
            // Gloss is not the wire's colour.
            parts.add([0, 1, 2].map(|channel| {
                let mut levels = wire.map(|rgb| rgb[channel]);
                levels.sort_unstable();
                levels[1]
            }));
            floor.add(colour_at(*floor_px));
        }
        let count = places.len();
        (count >= PLACES_MIN).then(|| Self { parts: parts.medians(count), floor: floor.medians(count) })
    }

    /// By how many grey levels the parts are brighter than the floor.
    pub fn luma_contrast(&self) -> f64 {
        luma_weights().dot(&(self.parts - self.floor))
    }

    /// How far the parts' colour is from the floor's, in levels, across the floor's own: what differs but in brightness is 0.
    pub fn hue_contrast(&self) -> f64 {
        self.across().norm()
    }

    /// Whether grey values tell parts from the floor better by colour than by luma, in both pictures of a pair.
    pub fn tell_more_than_luma(both: [&Self; 2]) -> bool {
        let hue = both[0].hue_contrast().min(both[1].hue_contrast());
        let lumas = both.map(Self::luma_contrast);
        // Where one picture shows parts brighter and the other darker, luma serves in neither.
        let is_torn = lumas[0] * lumas[1] < 0.0 && lumas.iter().all(|luma| luma.abs() >= LUMA_LEAST);
        let luma = if is_torn { 0.0 } else { (lumas[0] + lumas[1]) / 2.0 };
        let [least, ratio] = match luma {
            _ if luma.abs() < LUMA_LEAST => [HUE_LEAST, 0.0],
            _ if luma < 0.0 => HUE_OF_DARK,
            _ if luma < LUMA_ENOUGH => HUE_OF_BRIGHT,
            _ => return false,
        };
        hue >= least && hue >= ratio * luma.abs()
    }

    fn across(&self) -> Vector3<f64> {
        let way = self.parts - self.floor;
        match self.floor.try_normalize(BLACK) {
            Some(floor) => way - floor * floor.dot(&way),
            None => way,
        }
    }
}

/// Weights of R, G, B in luma.
fn luma_weights() -> Vector3<f64> {
    Vector3::from(LUMA_WEIGHTS).map(f64::from) / f64::from(1 << LUMA_SHIFT)
}

/// How often each level was seen, of R, G and B.
struct Levels([[u32; 256]; 3]);

impl Levels {
    const NONE: Self = Self([[0; 256]; 3]);

    fn add(&mut self, rgb: [u8; 3]) {
        for (counts, level) in self.0.iter_mut().zip(rgb) {
            counts[usize::from(level)] += 1;
        }
    }

    /// The medians of so many.
    fn medians(&self, count: usize) -> Vector3<f64> {
        let medians = self.0.each_ref().map(|counts| {
            let mut below = 0_usize;
            let median = counts.iter().position(|&times| {
                below += times as usize;
                2 * below >= count
            });
            median.unwrap_or(0) as f64
        });
        medians.into()
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
        self.run_until(frame, encoding, colours, None);
        &self.plane
    }

    /// As [`HuePlane::run`], broken off at this moment where it is given; says whether there was time.
    pub fn run_until(
        &mut self,
        frame: &Frame,
        encoding: ColourEncoding,
        colours: &Colours,
        end: Option<Timestamp>,
    ) -> bool {
        let across = colours.across();
        let scale = (PARTS - FLOOR) / across.norm_squared();
        let weights = (across * scale).map(|w| w as f32);
        let offset = (0.5 + FLOOR - colours.floor.dot(&across) * scale) as f32;
        // Gloss has the colour of the lamp.
        let brightest = luma_weights().dot(&colours.parts).max(luma_weights().dot(&colours.floor));
        let luma = luma_weights().map(|w| w as f32);
        let per_level = ((PARTS - FLOOR) / GLOSS[1]) as f32;
        let no_gloss = FLOOR as f32 - (brightest + GLOSS[0]) as f32 * per_level;
        let Self { plane } = self;
        let is_of_size = (frame.width, frame.height) == (plane.width, plane.height);
        let pixels =
            RgbView::with_encoding(frame, encoding).filter(|_| is_of_size && across.norm() >= ROUNDING);
        let Some(pixels) = pixels else {
            plane.bytes.fill(FLOOR as u8);
            return true;
        };
        // Rounded; what is out of range saturates.
        let grey = |[r, g, b]: [u8; 3]| {
            let [r, g, b] = [r, g, b].map(f32::from);
            let hue = offset + weights.x * r + weights.y * g + weights.z * b;
            let gloss = no_gloss + per_level * (luma.x * r + luma.y * g + luma.z * b);
            hue.max(gloss.min(PARTS as f32)) as u8
        };
        for (y, out) in plane.bytes.chunks_exact_mut(plane.width).enumerate() {
            if y.is_multiple_of(CLOCK_ROWS) && end.is_some_and(Timestamp::is_past) {
                return false;
            }
            if frame.format == PixelFormat::Rgb {
                let row = &frame.bytes[y * frame.stride_bytes..][..3 * frame.width];
                out.iter_mut().zip(row.as_chunks().0).for_each(|(out, rgb)| *out = grey(*rgb));
            } else {
                out.iter_mut().enumerate().for_each(|(x, out)| *out = grey(pixels.at(x, y)));
            }
        }
        true
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
        let colour_at = |x: usize, y: usize| match ((17..23).contains(&y), x < 20) {
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
        Colours::at(places, &RgbView::with_encoding(frame, frame.encoding)?, 0)
    }

    #[test]
    fn colours_stand_out_in_every_format_and_shadows_do_not() {
        for format in [PixelFormat::Rgb, PixelFormat::Bgr, PixelFormat::Yuyv] {
            let (frame, places) = picture([60, 130, 80], [190, 60, 110], format);
            let colours = colours(&frame, &places).expect("wire and floor");
            let mut stage = HuePlane::new(SIZE[0], SIZE[1]);
            assert!(Colours::tell_more_than_luma([&colours; 2]), "{format:?} {colours:?}");
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
            colours(&frame, &places).map(|colours| Colours::tell_more_than_luma([&colours; 2]))
        };
        assert_eq!(tell([40, 40, 40], [190, 190, 190]), Some(false), "grey");
        assert_eq!(tell([40, 40, 40], [210, 90, 60]), Some(false), "bright and red");
        assert_eq!(tell([90, 90, 90], [110, 110, 112]), Some(false), "hardly any difference");
        // Dark parts have shadows, and what is as bright has nothing else.
        assert_eq!(tell([180, 180, 180], [190, 50, 50]), Some(true), "dark and red");
        assert_eq!(tell([180, 180, 180], [60, 50, 50]), Some(false), "dark");
        assert_eq!(tell([90, 90, 90], [108, 84, 84]), Some(true), "pale");
        let of = |parts: [f64; 3]| Colours { parts: parts.into(), floor: Vector3::repeat(90.0) };
        let [pale, grey] = [of([108.0, 84.0, 84.0]), of([90.0, 90.0, 91.0])];
        assert!(!Colours::tell_more_than_luma([&pale, &grey]), "nothing in one of them");
        let (frame, _) = picture([9; 3], [9; 3], PixelFormat::Rgb);
        assert_eq!(colours(&frame, &[]), None, "no wire");
    }

    #[test]
    fn gloss_is_neither_the_wires_colour_nor_a_hole_in_it() {
        let (mut frame, places) = picture([60, 130, 80], [190, 60, 110], PixelFormat::Rgb);
        let clear = colours(&frame, &places).expect("wire and floor");
        // A white line along its middle, and one wire in five that is another's.
        for y in 19..21 {
            frame.bytes[y * frame.stride_bytes..][..3 * SIZE[0]].fill(250);
        }
        for x in 0..SIZE[0] / 5 {
            (17..23).for_each(|y| frame.bytes[y * frame.stride_bytes + 3 * x..][..3].fill(20));
        }
        let glossy = colours(&frame, &places).expect("wire and floor");
        assert_eq!(glossy, clear);
        let mut stage = HuePlane::new(SIZE[0], SIZE[1]);
        let plane = stage.run(&frame, frame.encoding, &glossy);
        assert_eq!([17, 19, 20, 22].map(|y| plane.luma(50, y)), [192; 4]);
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
