//! Camera pictures to raw ones: the recorded session's first picture on every instruction set, and zune-jpeg on it.

use criterion::{Criterion, criterion_group, criterion_main};
use pickcell::frame::{Frame, PixelFormat};
use pickcell::level::Level;
use pickcell::vision::decode::{Decoder, Output};
use std::hint::black_box;
use zune_core::{bytestream::ZCursor, colorspace::ColorSpace, options::DecoderOptions};
use zune_jpeg::JpegDecoder;

fn decode(c: &mut Criterion) {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/replay/conveyor/left/0000.jpg");
    let bytes = std::fs::read(path).expect("the recorded session");
    let (width, height) = (640, 480);
    let frame = Frame { bytes, format: PixelFormat::Mjpeg, width, height, ..Frame::default() };
    for (name, output, space) in
        [("luma", Output::Grey, ColorSpace::Luma), ("rgb", Output::Rgb, ColorSpace::RGB)]
    {
        let mut group = c.benchmark_group(format!("decode-{name}"));
        for &level in Level::available() {
            let mut decoder = Decoder::with_level(output, width, height, level);
            group.bench_function(level.name(), |b| {
                b.iter(|| black_box(decoder.run(black_box(&frame)).expect("a good picture").bytes[0]))
            });
        }
        let mut raw = vec![0; width * height * space.num_components()];
        group.bench_function("zune-jpeg", |b| {
            b.iter(|| {
                let options = DecoderOptions::default().jpeg_set_out_colorspace(space);
                let mut decoder = JpegDecoder::new_with_options(ZCursor::new(&frame.bytes), options);
                decoder.decode_into(black_box(&mut raw)).expect("a good picture");
            })
        });
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(40).warm_up_time(std::time::Duration::from_millis(200))
        .measurement_time(std::time::Duration::from_millis(600)).without_plots();
    targets = decode
}
criterion_main!(benches);
