//! Camera bytes to bits: every format, threshold and instruction set, over drawn pictures and a rendered scene.

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use pickcell::frame::{Frame, PixelFormat};
use pickcell::level::Level;
use pickcell::vision::binarize::{Binarize, ColourRange, Params};
use pickcell::vision::bits::BitImage;
use std::hint::black_box;

/// A dim, uneven floor with `bars` bright bars, in this format.
fn drawn(format: PixelFormat, width: usize, height: usize, bars: usize) -> Frame {
    let mut grey = vec![0u8; width * height];
    for (i, v) in grey.iter_mut().enumerate() {
        *v = 40 + ((i * 7919) % 97 / 8) as u8 + (i % width * 20 / width) as u8;
    }
    for bar in 0..bars {
        let (x0, y0) = (width * (bar * 37 % 100) / 130 + 10, height * (bar * 61 % 100) / 130 + 10);
        for t in 0..width / 6 {
            let (x, y) = (x0 + t, y0 + t * (bar % 7) / 8);
            for dy in 0..width / 90 {
                if let Some(v) = grey.get_mut((y + dy) * width + x) {
                    *v = 190;
                }
            }
        }
    }
    let (bytes, stride_bytes): (Vec<u8>, usize) = match format {
        PixelFormat::Rgb | PixelFormat::Bgr => (grey.iter().flat_map(|&v| [v; 3]).collect(), 3 * width),
        PixelFormat::Yuyv => (grey.iter().flat_map(|&v| [v, 128]).collect(), 2 * width),
        _ => {
            grey.resize(width * height * 3 / 2, 128);
            (grey, width)
        }
    };
    Frame { bytes, format, width, height, stride_bytes, ..Frame::default() }
}

fn colours() -> [(&'static str, ColourRange); 3] {
    [
        ("box", ColourRange::Rgb { min: [100; 3], max: [255; 3] }),
        ("grey", ColourRange::Grey { min: 100, max: 255 }),
        ("auto", ColourRange::Auto),
    ]
}

fn run(c: &mut Criterion, group: &str, name: &str, params: Params, level: Level, frame: &Frame) {
    let (width, height) = (frame.width, frame.height);
    let mut stage = Binarize::with_level(params, width, height, level).expect("good parameters");
    let mut bits = BitImage::new(width, height);
    let id = BenchmarkId::new(format!("{name}/{}", level.name()), format!("{width}x{height}"));
    c.benchmark_group(group).bench_function(id, |b| {
        b.iter(|| {
            stage.run(black_box(frame), &mut bits).expect("a good frame");
            black_box(bits.words()[0])
        })
    });
}

fn formats(c: &mut Criterion) {
    for (width, height) in [(640, 480), (1920, 1080)] {
        for (format, format_name) in [
            (PixelFormat::Rgb, "rgb"),
            (PixelFormat::Yuyv, "yuyv"),
            (PixelFormat::Nv12, "nv12"),
            (PixelFormat::Grey, "grey"),
        ] {
            let frame = drawn(format, width, height, 20);
            for (colour_name, colour) in colours() {
                for &level in Level::available() {
                    let params = Params { colour, ..Params::default() };
                    run(c, "binarize", &format!("{format_name}-{colour_name}"), params, level, &frame);
                }
            }
        }
    }
}

fn whole_stage(c: &mut Criterion) {
    let level = Level::detect();
    let mut frames = vec![
        ("drawn-20", drawn(PixelFormat::Rgb, 640, 480, 20)),
        ("drawn-100", drawn(PixelFormat::Rgb, 1920, 1080, 100)),
    ];
    let scene = concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/scenes/sets/overlap-rods/scene-06/left.jpg");
    match image::open(scene) {
        Ok(picture) => {
            let picture = picture.to_rgb8();
            let (width, height) = (picture.width() as usize, picture.height() as usize);
            frames.push(("overlap-rods-06", Frame::from_rgb(width, height, picture.into_raw())));
        }
        Err(_) => eprintln!("no rendered scene beside the project: left out"),
    }
    for (name, frame) in &frames {
        for (colour_name, colour) in colours() {
            let params = Params { colour, speck_px_min: 20, ..Params::default() };
            run(c, "binarize-specks", &format!("{name}-{colour_name}"), params, level, frame);
        }
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(40).warm_up_time(std::time::Duration::from_millis(200))
        .measurement_time(std::time::Duration::from_millis(600)).without_plots();
    targets = formats, whole_stage
}
criterion_main!(benches);
