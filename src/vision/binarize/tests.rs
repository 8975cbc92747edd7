//! All instruction sets against a pixel at a time, all formats against each other.

use super::*;
use crate::frame::{LumaView, QuantizationRange, YcbcrMatrix};
use crate::vision::decode::{Decoder, Output};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};

/// One pixel at a time, by the frame's own reading of its pixels.
fn slow(params: &Params, frame: &Frame) -> BitImage {
    let encoding = params.encoding.unwrap_or(frame.encoding);
    let frame = &Frame { encoding, ..frame.clone() };
    let luma = LumaView::new(frame).expect("a raw frame");
    let mut bits = BitImage::new(frame.width, frame.height);
    for y in 0..frame.height {
        for x in 0..frame.width {
            let inside = match params.colour {
                ColourRange::Rgb { min, max } => {
                    let rgb = frame.rgb(x, y);
                    (0..3).all(|c| (min[c]..=max[c]).contains(&rgb[c]))
                }
                ColourRange::Grey { min, max } => (min..=max).contains(&luma.at(x, y)),
                ColourRange::Auto => unreachable!("no threshold of its own"),
            };
            bits.set(x, y, inside != params.inverted);
        }
    }
    bits
}

fn run(params: &Params, level: Level, frame: &Frame) -> BitImage {
    let mut stage =
        Binarize::with_level(params.clone(), frame.width, frame.height, level).expect("good parameters");
    let mut bits = BitImage::new(frame.width, frame.height);
    // What was there before must not matter.
    (0..frame.width.min(frame.height)).for_each(|i| bits.set(i, i, true));
    stage.run(frame, &mut bits).expect("a good frame");
    bits
}

const FORMATS: [PixelFormat; 5] =
    [PixelFormat::Rgb, PixelFormat::Bgr, PixelFormat::Grey, PixelFormat::Yuyv, PixelFormat::Nv12];

/// A frame of this format whose bytes come from a few numbers.
fn frame_of(format: PixelFormat, width: usize, height: usize, gap: usize, seed: u32) -> Frame {
    let row = match format {
        PixelFormat::Rgb | PixelFormat::Bgr => 3 * width,
        PixelFormat::Yuyv => 2 * width.next_multiple_of(2),
        _ => width.next_multiple_of(2),
    };
    let mut frame = Frame { format, width, height, stride_bytes: row + gap, ..Frame::default() };
    frame.encoding = ColourEncoding {
        matrix: if seed & 1 == 0 { YcbcrMatrix::Bt601 } else { YcbcrMatrix::Bt709 },
        range: if seed & 2 == 0 { QuantizationRange::Limited } else { QuantizationRange::Full },
    };
    let mut state = seed;
    frame.bytes.resize_with(frame.bytes_needed(), || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    });
    frame
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn every_instruction_set_gives_what_a_pixel_at_a_time_gives(
        format in 0usize..5, size in (1usize..200, 1usize..12), gap in 0usize..5, seed: u32,
        ends in any::<[(u8, u8); 3]>(), grey: bool, inverted: bool
    ) {
        let frame = frame_of(FORMATS[format], size.0, size.1, gap, seed);
        let (min, max) = (ends.map(|(a, b)| a.min(b)), ends.map(|(a, b)| a.max(b)));
        let colour =
            if grey { ColourRange::Grey { min: min[0], max: max[0] } } else { ColourRange::Rgb { min, max } };
        let params = Params { colour, inverted, ..Params::default() };
        let expected = slow(&params, &frame);
        for &level in Level::available() {
            prop_assert_eq!(run(&params, level, &frame).to_text(), expected.to_text(), "{:?}", level);
        }
    }

    #[test]
    fn every_instruction_set_finds_the_same_thresholds(
        format in 0usize..5, size in (1usize..200, 1usize..90), seed: u32, inverted: bool, floor in 1u8..60
    ) {
        let mut frame = frame_of(FORMATS[format], size.0, size.1, 0, seed);
        for (i, byte) in frame.bytes.iter_mut().enumerate() {
            if *byte < 250 && i % 7 != 0 {
                *byte = floor + *byte % 16;
            }
        }
        let params = Params { inverted, ..Params::default() };
        let expected = run(&params, Level::Plain, &frame);
        for &level in Level::available() {
            prop_assert_eq!(run(&params, level, &frame).to_text(), expected.to_text(), "{:?}", level);
        }
    }
}

/// Every combination of a pixel's Y, Cb and Cr, in steps, at box ends that cut through it.
#[test]
fn conversions_are_exact_at_the_ends_of_a_box() {
    let mut frame = frame_of(PixelFormat::Yuyv, 256, 64, 0, 0);
    for (i, group) in frame.bytes.chunks_exact_mut(4).enumerate() {
        let (u, v) = ((i % 128 * 2) as u8, (i / 128 * 4) as u8);
        group.copy_from_slice(&[(i * 37) as u8, u, (i * 91 + 5) as u8, v]);
    }
    for encoding in [YcbcrMatrix::Bt601, YcbcrMatrix::Bt709]
        .map(|matrix| ColourEncoding { matrix, range: QuantizationRange::Full })
    {
        for min in (0..=250).step_by(25) {
            let colour = ColourRange::Rgb { min: [min; 3], max: [min.saturating_add(60); 3] };
            let params = Params { colour, encoding: Some(encoding), ..Params::default() };
            let expected = slow(&params, &frame);
            for &level in Level::available() {
                assert_eq!(run(&params, level, &frame), expected, "{level:?} {min}");
            }
        }
    }
}

#[test]
fn bad_ranges_and_frames_are_refused_in_words() {
    let colour = ColourRange::Rgb { min: [0, 200, 0], max: [255, 100, 255] };
    let error = Binarize::new(Params { colour, ..Params::default() }, 8, 8).expect_err("empty").to_string();
    assert_eq!(
        error,
        "colour range is empty: color_min/color_max green goes from 200 to 100; give a minimum that is not above the maximum"
    );
    let mut stage = Binarize::new(Params::default(), 8, 8).expect("good parameters");
    let mut bits = BitImage::new(8, 8);
    let mut refuse = |frame: &Frame| stage.run(frame, &mut bits).expect_err("refused").to_string();
    let good = Frame::from_rgb(8, 8, vec![0; 192]);
    assert!(refuse(&Frame::from_rgb(4, 8, vec![0; 96])).starts_with("picture is 4x8 where 8x8 was set up"));
    assert!(
        refuse(&Frame { bytes: vec![0; 100], ..good.clone() })
            .contains("100 bytes where its size and format need 192")
    );
    assert!(
        refuse(&Frame { stride_bytes: 20, ..good.clone() })
            .contains("rows of 20 bytes, less than its 8 pixels")
    );
    assert!(refuse(&Frame { format: PixelFormat::Mjpeg, ..good }).contains("still MJPEG"));
    assert!(Binarize::new(Params::default(), 0, 8).is_err());
}

/// A bin of dim, uneven floor under a gradient of light with a few bright bars.
fn bin(light: impl Fn(usize, usize) -> f32, bars: bool) -> Frame {
    let (width, height) = (320, 240);
    let mut bytes = Vec::with_capacity(3 * width * height);
    for y in 0..height {
        for x in 0..width {
            let noise = ((x * 7919 + y * 104_729) % 97) as f32 / 97.0 - 0.5;
            let bar = bars && is_bar(x, y);
            let v = light(x, y) * if bar { 200.0 } else { 45.0 + 12.0 * noise };
            bytes.extend([v.clamp(0.0, 255.0) as u8; 3]);
        }
    }
    Frame::from_rgb(width, height, bytes)
}

fn is_bar(x: usize, y: usize) -> bool {
    (40..45).contains(&y) && (30..280).contains(&x) || (200..205).contains(&x) && (60..200).contains(&y)
}

/// Pixels that are object without being bars, and the reverse.
fn wrong(bits: &BitImage) -> (usize, usize) {
    let mut wrong = (0, 0);
    for y in 0..bits.height() {
        for x in 0..bits.width() {
            match (bits.get(x as i32, y as i32), is_bar(x, y)) {
                (true, false) => wrong.0 += 1,
                (false, true) => wrong.1 += 1,
                _ => {}
            }
        }
    }
    wrong
}

#[test]
fn a_threshold_of_its_own_follows_brightness_and_gradients() {
    for gain in [0.5, 0.7, 1.0, 1.3] {
        let frame = bin(|x, _| gain * (0.5 + x as f32 / 320.0), true);
        assert_eq!(wrong(&run(&Params::default(), Level::detect(), &frame)), (0, 0), "light {gain}");
    }
}

#[test]
fn an_empty_bin_has_no_objects() {
    for gain in [0.3, 1.0, 1.3] {
        let frame = bin(|x, y| gain * (0.5 + (x + y) as f32 / 400.0), false);
        assert_eq!(run(&Params::default(), Level::detect(), &frame).count(), 0, "light {gain}");
    }
    let black = Frame::from_rgb(64, 48, vec![0; 64 * 48 * 3]);
    assert_eq!(run(&Params::default(), Level::detect(), &black).count(), 0);
    let white = Frame::from_rgb(64, 48, vec![255; 64 * 48 * 3]);
    assert_eq!(run(&Params::default(), Level::detect(), &white).count(), 0);
}

#[test]
fn dark_parts_on_a_light_floor_are_found_where_inverted() {
    let mut frame = bin(|x, _| 0.6 + x as f32 / 640.0, true);
    frame.bytes.iter_mut().for_each(|v| *v = (12_000 / (u32::from(*v) + 20)).min(255) as u8);
    let params = Params { inverted: true, ..Params::default() };
    assert_eq!(wrong(&run(&params, Level::detect(), &frame)), (0, 0));
    assert_eq!(run(&Params::default(), Level::detect(), &frame).count(), 0, "bright parts: there are none");
}

#[test]
fn only_the_region_counts_and_only_in_it_is_anything_found() {
    let mut frame = bin(|_, _| 1.0, true);
    // A lamp beside the bin would draw the threshold up to it.
    for y in 210..240 {
        frame.bytes[3 * (320 * y)..3 * (320 * y + 40)].fill(255);
    }
    let region_px = vec![[10.0, 10.0], [310.0, 10.0], [310.0, 205.0], [10.0, 205.0]];
    let params = Params { region_px, speck_px_min: 20, ..Params::default() };
    assert_eq!(wrong(&run(&params, Level::detect(), &frame)), (0, 0));
    let elsewhere = vec![[10.0, 60.0], [150.0, 60.0], [150.0, 200.0], [10.0, 200.0]];
    let params = Params { region_px: elsewhere, ..Params::default() };
    assert_eq!(run(&params, Level::detect(), &frame).count(), 0);
}

/// A bin under uneven light with bars in several colours, rows of R, G, B.
fn coloured(width: usize, height: usize) -> Frame {
    let colours = [[210.0, 205.0, 200.0], [200.0, 180.0, 140.0], [150.0, 170.0, 210.0]];
    let mut bytes = Vec::with_capacity(3 * width * height);
    for y in 0..height {
        for x in 0..width {
            let light = 0.8 + 0.4 * x as f32 / width as f32;
            // Distance to the middle of the nearest slanting bar; bars are 8 px wide with soft edges.
            let across = (x as f32 + 0.3 * y as f32).rem_euclid(60.0) - 30.0;
            let share = (4.5 - across.abs()).clamp(0.0, 1.0);
            let colour = colours[(x as f32 + 0.3 * y as f32) as usize / 60 % 3];
            let floor = [38.0, 42.0, 52.0];
            bytes.extend(
                (0..3).map(|c| (light * (floor[c] + share * (colour[c] - floor[c]))).min(255.0) as u8),
            );
        }
    }
    Frame::from_rgb(width, height, bytes)
}

/// The same picture as a camera with subsampled chroma sends it (BT.601, limited range).
fn as_ycbcr(rgb: &Frame, format: PixelFormat) -> Frame {
    let (w, h) = (rgb.width, rgb.height);
    let ycbcr = |x: usize, y: usize| {
        let [r, g, b] = rgb.rgb(x, y).map(f32::from);
        let luma = 0.299 * r + 0.587 * g + 0.114 * b;
        let chroma = |c: f32, k: f32| 128.0 + (c - luma) / (2.0 * (1.0 - k)) * 224.0 / 255.0;
        [16.0 + luma * 219.0 / 255.0, chroma(b, 0.114), chroma(r, 0.299)]
    };
    // The mean chroma of the pixels that share it.
    let shared = |x: usize, y: usize, rows: usize, c: usize| {
        let sum: f32 = (0..rows)
            .flat_map(|dy| (0..2).map(move |dx| (dx, dy)))
            .map(|(dx, dy)| ycbcr(x + dx, y + dy)[c])
            .sum();
        (sum / (2 * rows) as f32).round() as u8
    };
    let luma = |x: usize, y: usize| ycbcr(x, y)[0].round() as u8;
    let mut bytes = Vec::new();
    if format == PixelFormat::Yuyv {
        for (y, x) in (0..h).flat_map(|y| (0..w).step_by(2).map(move |x| (y, x))) {
            bytes.extend([luma(x, y), shared(x, y, 1, 1), luma(x + 1, y), shared(x, y, 1, 2)]);
        }
        return Frame { bytes, format, stride_bytes: 2 * w, ..rgb.clone() };
    }
    bytes.extend((0..h).flat_map(|y| (0..w).map(move |x| (x, y))).map(|(x, y)| luma(x, y)));
    for (y, x) in (0..h).step_by(2).flat_map(|y| (0..w).step_by(2).map(move |x| (y, x))) {
        bytes.extend([shared(x, y, 2, 1), shared(x, y, 2, 2)]);
    }
    Frame { bytes, format, stride_bytes: w, ..rgb.clone() }
}

/// The same scene in every format: at most one pixel in 200 differs, and all that do are beside an edge of the bars.
#[test]
fn formats_differ_only_where_chroma_is_shared_across_an_edge() {
    let rgb = coloured(320, 240);
    let mut jpeg = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, 92)
        .encode(&rgb.bytes, 320, 240, image::ExtendedColorType::Rgb8)
        .expect("encodes");
    let mjpeg = Frame { bytes: jpeg, format: PixelFormat::Mjpeg, ..rgb.clone() };
    let colours = [
        ColourRange::Rgb { min: [100; 3], max: [255; 3] },
        ColourRange::Grey { min: 110, max: 255 },
        ColourRange::Auto,
    ];
    for colour in colours {
        let params = Params { colour, ..Params::default() };
        let expected = run(&params, Level::detect(), &rgb);
        assert!(expected.count() > 320 * 240 / 10, "{colour:?}: the bars are object");
        let luma_only = Binarize::new(params.clone(), 320, 240).unwrap().needs_luma_only();
        let output = if luma_only { Output::Grey } else { Output::Rgb };
        let mut decoder = Decoder::new(output, 320, 240);
        let frames = [
            as_ycbcr(&rgb, PixelFormat::Yuyv),
            as_ycbcr(&rgb, PixelFormat::Nv12),
            decoder.run(&mjpeg).expect("decodes").clone(),
        ];
        for (name, frame) in ["YUYV", "NV12", "MJPEG"].into_iter().zip(&frames) {
            let bits = run(&params, Level::detect(), frame);
            let mut differing = 0;
            for (x, y) in (0..240).flat_map(|y| (0..320).map(move |x| (x, y))) {
                if bits.get(x, y) != expected.get(x, y) {
                    differing += 1;
                    // At the picture's border an edge may lie just outside.
                    let objects = (-2..=2).filter(|dx| expected.get(x + dx, y)).count();
                    let on_edge = (1..5).contains(&objects) || !(2..318).contains(&x);
                    assert!(on_edge, "{name}, {colour:?}: ({x}, {y}) is not on an edge");
                }
            }
            assert!(differing <= 320 * 240 / 200, "{name}, {colour:?}: {differing} pixels differ");
        }
    }
}

/// Parts 6 pixels wide with 2 pixels of shaded flank between them, over more of the floor than the background is looked
/// for in, and one that lies alone.
#[test]
fn floor_that_a_heap_hides_is_known_from_around() {
    let (w, h) = (320, 240);
    for dark in [false, true] {
        let level = |x: usize, y: usize| match (x, y) {
            (100..=219, 60..=179) => {
                if x % 8 < 6 {
                    190
                } else {
                    95
                }
            }
            (20..=25, 60..=179) => 190,
            _ => 40,
        };
        let bytes =
            (0..w * h).map(|i| level(i % w, i / w)).map(|v: u8| if dark { 230 - v } else { v }).collect();
        let frame = Frame::from_grey(w, h, bytes);
        let params = Params { colour: ColourRange::Auto, inverted: dark, ..Params::default() };
        for &by in Level::available() {
            let bits = run(&params, by, &frame);
            let object = |x: usize| (70..170).all(|y| bits.get(x as i32, y));
            assert!((102..218).filter(|x| x % 8 < 6).all(object), "{by:?}, dark: {dark}");
            assert!((20..26).all(object) && !object(60) && !object(260), "{by:?}, dark: {dark}");
        }
    }
}

/// Two wires, and a reflection (of dark parts: a black wall) larger than the background is looked for in, clipped or nearly.
#[test]
fn what_the_camera_clips_over_an_area_is_no_object() {
    for dark in [false, true] {
        let found = |patch: u8, by: Level| {
            let level = |x: usize, y: usize| match (x, y) {
                (300..306 | 400..406, 60..180) => 190,
                (40..200, 40..200) => patch,
                _ => 50,
            };
            let bytes = (0..640 * 240).map(|i| level(i % 640, i / 640));
            let bytes = bytes.map(|v: u8| if dark { 255 - v } else { v }).collect();
            let params = Params { colour: ColourRange::Auto, inverted: dark, ..Params::default() };
            let bits = run(&params, by, &Frame::from_grey(640, 240, bytes));
            assert!((60..180).all(|y| bits.get(303, y) && !bits.get(500, y)), "{patch} {by:?}");
            (70..170).all(|y| (70..170).all(|x| !bits.get(x, y)))
        };
        for &by in Level::available() {
            assert!([240, 254, 255].into_iter().all(|patch| found(patch, by)), "dark: {dark}, {by:?}");
        }
    }
}

/// Pairs of wires with their shadows beside them, closer together than the background is looked for in.
#[test]
fn floor_in_the_light_between_shadows_is_no_object() {
    let (w, h) = (640, 480);
    for [floor, part, shadow] in [[95, 190, 28], [60, 170, 12], [130, 235, 40]] {
        let level = |x: usize, y: usize| match (x % 120, y) {
            (60..66 | 82..88, 120..360) => part,
            (66..74 | 88..96, 120..360) => shadow,
            _ => floor,
        };
        let frame = Frame::from_grey(w, h, (0..w * h).map(|i| level(i % w, i / w)).collect());
        let params = Params { colour: ColourRange::Auto, ..Params::default() };
        for &by in Level::available() {
            let bits = run(&params, by, &frame);
            let wrong = (0..w * h).filter(|i| {
                let (x, y) = (i % w, i / w);
                bits.get(x as i32, y as i32) != (level(x, y) == part)
            });
            assert_eq!(wrong.count(), 0, "{floor} {part} {shadow} {by:?}");
        }
    }
}

/// An even floor with or without bars and, beside a darker wall, a lighter rim.
fn walled([floor, bar, wall, rim]: [u8; 4], bars: bool) -> Frame {
    let grey = |x: usize, y: usize| match x {
        8..12 => rim,
        12..20 => wall,
        _ if bars && is_bar(x, y) => bar,
        _ => floor,
    };
    let pixels = (0..240).flat_map(|y| (0..320).flat_map(move |x| [grey(x, y); 3]));
    Frame::from_rgb(320, 240, pixels.collect())
}

#[test]
fn parts_on_a_floor_of_any_grey_are_found_and_a_rim_beside_its_dark_wall_is_none() {
    // The first two as dark as light of a tenth and of a third makes them.
    for greys in [[5, 22, 3, 7], [14, 60, 8, 22], [45, 180, 25, 58], [100, 150, 60, 120], [130, 190, 80, 155]]
    {
        for level in Level::available() {
            let found = |bars| run(&Params::default(), *level, &walled(greys, bars));
            assert_eq!(wrong(&found(true)), (0, 0), "{greys:?} {level:?}");
            assert_eq!(found(false).count(), 0, "{greys:?} {level:?}");
        }
    }
    // Dark parts, and a dark rim beside a wall in full light.
    for greys in [[200, 60, 230, 175], [150, 95, 190, 130]] {
        for level in Level::available() {
            let params = Params { inverted: true, ..Params::default() };
            let found = |bars| run(&params, *level, &walled(greys, bars));
            assert_eq!(wrong(&found(true)), (0, 0), "{greys:?} {level:?}");
            assert_eq!(found(false).count(), 0, "{greys:?} {level:?}");
        }
    }
}

#[test]
fn a_lone_part_between_the_samples_is_found_and_a_rim_beside_a_dark_wall_is_not() {
    // A floor; wires of sixty pixels and a picture of rim and wall between the rows and columns that are sampled, 4 modulo 8.
    let (floor, wall, rim, part) = (75u8, 20, 82, 200);
    let picture = |is_part: fn(usize, usize) -> bool, is_dark: bool| {
        let pixels = (0..480usize).flat_map(|y| (0..640usize).map(move |x| (x, y))).map(|(x, y)| {
            let level = match y {
                _ if is_part(x, y) => part,
                440..456 if (445..447).contains(&y) => rim,
                440..456 => wall,
                _ => floor,
            };
            if is_dark { 255 - level } else { level }
        });
        Frame::from_grey(640, 480, pixels.collect())
    };
    for is_dark in [false, true] {
        let params = Params { colour: ColourRange::Auto, inverted: is_dark, ..Params::default() };
        for &level in Level::available() {
            let level_wire: fn(usize, usize) -> bool =
                |x, y| (205..209).contains(&y) && (301..361).contains(&x);
            let upright: fn(usize, usize) -> bool = |x, y| (201..261).contains(&y) && (301..304).contains(&x);
            for is_part in [level_wire, upright] {
                let bits = run(&params, level, &picture(is_part, is_dark));
                for y in 0..480 {
                    for x in 0..640 {
                        let found = bits.get(x as i32, y as i32);
                        assert_eq!(found, is_part(x, y), "({x}, {y}), dark {is_dark}, {level:?}");
                    }
                }
            }
            let empty = run(&params, level, &picture(|_, _| false, is_dark));
            assert!(empty.words().iter().all(|&word| word == 0), "dark {is_dark}, {level:?}");
        }
    }
}

#[test]
fn a_threshold_reads_no_pixel_outside_of_the_picture() {
    for (width, height) in [(2000, 6), (640, 3), (12, 1736), (1, 7681), (64, 8192), (1, 1)] {
        let stride_bytes = width + 6;
        let frame = |beside: u8| {
            let mut bytes = vec![beside; stride_bytes * height + 9];
            for (y, row) in bytes.chunks_mut(stride_bytes).take(height).enumerate() {
                let level = |x: usize| if (x + y) % 100 < 4 { 220 } else { 90 };
                row[..width].iter_mut().enumerate().for_each(|(x, pixel)| *pixel = level(x));
            }
            Frame { stride_bytes, bytes, ..Frame::from_grey(width, height, vec![0; width * height]) }
        };
        for &level in Level::available() {
            let masks = [0, 90, 255].map(|beside| {
                let params = Params { colour: ColourRange::Auto, ..Params::default() };
                let mut bits = BitImage::new(width, height);
                let mut binarize = Binarize::with_level(params, width, height, level).expect("a size");
                let _ = binarize.run(&frame(beside), &mut bits);
                bits
            });
            assert!(masks[0] == masks[1] && masks[1] == masks[2], "{width}x{height} {level:?}");
        }
    }
}

#[test]
fn noise_is_refused_and_no_empty_picture() {
    // One pixel in four of every fourth row.
    let specks = |count: usize| {
        let mut bytes = vec![20u8; 640 * 480];
        (0..count).for_each(|k| bytes[4 * (k % 160) + 640 * 4 * (k / 160)] = 220);
        Frame::from_grey(640, 480, bytes)
    };
    let colour = ColourRange::Grey { min: 100, max: 255 };
    let params = Params { colour, speck_px_min: 20, ..Params::default() };
    for &level in Level::available() {
        let mut binarize = Binarize::with_level(params.clone(), 640, 480, level).unwrap();
        let mut bits = BitImage::new(640, 480);
        assert_eq!(binarize.run(&specks(4800), &mut bits), Ok(()));
        assert!(bits.words().iter().all(|word| *word == 0), "{level:?}");
        let refusal = binarize.run(&specks(4801), &mut bits);
        assert_eq!(refusal, Err(Refusal::Specks { specks_max: 4800 }), "{level:?}");
        assert_eq!(binarize.run(&specks(7), &mut bits), Ok(()));
        let mut random = rand_pcg::Pcg32::seed_from_u64(1);
        for _ in 0..3 {
            let sparse =
                (0..640 * 480).map(|_| if random.random::<f32>() < 0.1 { 200 } else { 20 }).collect();
            let refusal = binarize.run(&Frame::from_grey(640, 480, sparse), &mut bits);
            assert_eq!(refusal, Err(Refusal::Specks { specks_max: 4800 }), "{level:?}");
        }
    }
}
