//! The hot stages allocate nothing after `new` and one run.

use nalgebra::Vector3;
use pickcell::frame::{Frame, FramePair, PixelFormat};
use pickcell::level::Level;
use pickcell::part::Part;
use pickcell::pose::drawn::DrawnPair;
use pickcell::pose::model::PoseModel;
use pickcell::recognize::{self, Recognition, Recognizer};
use pickcell::rig::{CameraModel, Rig};
use pickcell::session::{RecordedPair, Session};
use pickcell::time::Budget;
use pickcell::vision::binarize::{Binarize, ColourRange, Params};
use pickcell::vision::bits::BitImage;
use pickcell::vision::decode::{Decoder, Output};
use pickcell::vision::{graph, thin};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

/// The system's allocator, counting what each thread asks for.
struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

fn count() {
    // While a thread ends its count is gone already, and of no interest.
    let _ = ALLOCATIONS.try_with(|n| n.set(n.get() + 1));
}

// SAFETY: everything is handed on to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller keeps the contract of `alloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: the caller keeps the contract of `dealloc`.
        unsafe { System.dealloc(memory, layout) }
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: the caller keeps the contract of `realloc`.
        unsafe { System.realloc(memory, layout, size) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

/// How often this thread allocates while `work` runs.
fn allocations_of(work: impl FnOnce()) -> usize {
    let before = ALLOCATIONS.with(Cell::get);
    work();
    ALLOCATIONS.with(Cell::get) - before
}

/// A dim floor with bright bars and specks; the larger `moment`, the more of them.
fn frame(format: PixelFormat, moment: usize) -> Frame {
    let (width, height) = (320, 240);
    let row = match format {
        PixelFormat::Rgb | PixelFormat::Bgr => 3 * width,
        PixelFormat::Yuyv => 2 * width,
        _ => width,
    };
    let mut frame = Frame { format, width, height, stride_bytes: row, ..Frame::default() };
    frame.bytes.resize(frame.bytes_needed(), 128);
    for (i, byte) in frame.bytes[..row * height].iter_mut().enumerate() {
        let (x, y) = (i % row * width / row, i / row);
        let object = (x + y / 3) % 40 < 6 * moment || (x * 31 + y * 17) % 257 < moment;
        *byte = if object { 200 } else { 40 };
    }
    frame
}

#[test]
fn the_counter_counts() {
    assert_eq!(allocations_of(|| drop(std::hint::black_box(vec![1u8; 100]))), 1);
}

#[test]
fn shared_work_allocates_nothing_in_either_thread() {
    let (mut owner, helper) = pickcell::hands::hands().expect("descriptors");
    let thread = std::thread::spawn(move || helper.work());
    let mut count = || {
        let mut there = 0;
        let here = allocations_of(|| {
            let begun = || ALLOCATIONS.with(Cell::get);
            (_, there) = owner.both(|| (), begun);
        });
        (here, there)
    };
    let (_, before) = count();
    for _ in 0..100 {
        assert_eq!(count(), (0, before));
    }
    drop(owner);
    thread.join().expect("no panic");
}

#[test]
fn binarize_allocates_nothing_after_new() {
    let region = vec![[10.0, 10.0], [300.0, 5.0], [310.0, 230.0], [5.0, 220.0]];
    let colours = [
        ColourRange::Rgb { min: [100; 3], max: [255; 3] },
        ColourRange::Grey { min: 100, max: 255 },
        ColourRange::Auto,
    ];
    let formats =
        [PixelFormat::Rgb, PixelFormat::Bgr, PixelFormat::Grey, PixelFormat::Yuyv, PixelFormat::Nv12];
    for (format, colour) in formats.into_iter().flat_map(|f| colours.map(|c| (f, c))) {
        let frames: Vec<Frame> = (0..4).map(|moment| frame(format, moment)).collect();
        for &level in Level::available() {
            let params =
                Params { colour, region_px: region.clone(), speck_px_min: 2000, ..Params::default() };
            let mut stage = Binarize::with_level(params, 320, 240, level).expect("good parameters");
            let mut bits = BitImage::new(320, 240);
            let allocations = allocations_of(|| {
                for frame in &frames {
                    stage.run(frame, &mut bits).expect("a good frame");
                }
            });
            assert_eq!(allocations, 0, "{format:?}, {colour:?}, {level:?}");
        }
    }
}

#[test]
fn decoding_allocates_nothing_after_new() {
    let mut rgb = vec![40u8; 3 * 320 * 240];
    rgb.chunks_exact_mut(7).for_each(|some| some[0] = 200);
    let mut bytes = Vec::new();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 85)
        .encode(&rgb, 320, 240, image::ExtendedColorType::Rgb8)
        .expect("encodes");
    let mjpeg = Frame { bytes, format: PixelFormat::Mjpeg, width: 320, height: 240, ..Frame::default() };
    for output in [Output::Rgb, Output::Grey] {
        let mut decoder = Decoder::new(output, 320, 240);
        let mut decoded = false;
        assert_eq!(allocations_of(|| decoded = decoder.run(&mjpeg).is_ok()), 0, "{output:?}");
        assert!(decoded);
    }
}

#[test]
fn thin_and_graph_allocate_nothing_after_one_run() {
    let colour = ColourRange::Grey { min: 100, max: 255 };
    let mut binarize =
        Binarize::new(Params { colour, ..Params::default() }, 320, 240).expect("good parameters");
    let masks: Vec<(Frame, BitImage)> = (0..4)
        .map(|moment| {
            let frame = frame(PixelFormat::Rgb, moment);
            let mut mask = BitImage::new(320, 240);
            binarize.run(&frame, &mut mask).expect("a good frame");
            (frame, mask)
        })
        .collect();
    for algorithm in [thin::Algorithm::ZhangSuen, thin::Algorithm::GuoHall] {
        for &level in Level::available() {
            let mut thin = thin::Thin::with_level(thin::Params { algorithm }, 320, 240, level);
            let mut graphs = graph::Graphs::with_level(graph::Params::default(), 320, 240, level);
            let (mut skeleton, mut graph) = (BitImage::new(320, 240), graph::Graph::default());
            let mut run = |(frame, mask): &(Frame, BitImage)| {
                thin.run(mask, &mut skeleton);
                // More than the limits, too: a refusal is no reason to allocate.
                let _ = graphs.run(&skeleton, mask, Some(frame), &mut graph);
            };
            // The first picture is empty: what comes later must fit all the same.
            run(&masks[0]);
            assert_eq!(allocations_of(|| masks.iter().for_each(&mut run)), 0, "{algorithm:?}, {level:?}");
        }
    }
}

/// The first pairs of the recorded session, with what is made of their pictures.
fn pairs_with(change: impl Fn(&Frame) -> Frame) -> Vec<FramePair> {
    let replay = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("replay");
    let session = Session::open(&replay.join("conveyor")).unwrap();
    let pair = |pair: &RecordedPair| {
        let [Some(left), Some(right)] = &pair.pictures else { panic!("a whole pair") };
        let [left, right] = [left, right].map(|picture| change(&picture.read_raw().unwrap()));
        FramePair { left, right }
    };
    session.pairs[..3].iter().map(pair).collect()
}

#[test]
fn pictures_of_thick_wire_are_halved_and_a_turned_camera_allowed_for_without_an_allocation() {
    let replay = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("replay");
    let Rig { left, right, right_from_left } = Rig::read(replay.join("conveyor/calibration.yaml")).unwrap();
    let twice = |c: CameraModel| CameraModel {
        width: 2 * c.width,
        height: 2 * c.height,
        fx: 2.0 * c.fx,
        fy: 2.0 * c.fy,
        cx: 2.0 * c.cx + 0.5,
        cy: 2.0 * c.cy + 0.5,
        ..c
    };
    let rig = Rig { left: twice(left), right: twice(right), right_from_left };
    let rig = rig.with_right_turned(&Vector3::new(4.0 / right.fy, 0.0, 0.0));
    let rod = Part::read(replay.join("parts/rod-90.toml")).unwrap();
    let mut recognizer = Recognizer::new(Default::default(), rig, vec![rod]).unwrap();
    let pairs = pairs_with(|small| {
        let pixels = (0..960 * 1280).flat_map(|at| small.rgb(at % 1280 / 2, at / 1280 / 2));
        Frame::from_rgb(1280, 960, pixels.collect())
    });
    let mut found = Recognition::default();
    let mut run = |pair: &FramePair| {
        recognizer.run(pair, Budget::Iterations(100_000), 1, &mut found).unwrap();
        assert_eq!(recognizer.pictures()[0].halvings(), 1);
        assert!(found.turned.is_some_and(|turned| turned.is_allowed_for()));
        found.parts.len()
    };
    run(&pairs[0]);
    let mut parts = 0;
    assert_eq!(allocations_of(|| parts = pairs.iter().map(&mut run).sum()), 0);
    assert!(parts > 20, "{parts}");
}

#[test]
fn neither_dark_parts_nor_coloured_ones_want_an_allocation() {
    let replay = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("replay");
    let rig = Rig::read(replay.join("conveyor/calibration.yaml")).unwrap();
    let rod = Part::read(replay.join("parts/rod-90.toml")).unwrap();
    let dark = |[r, g, b]: [u8; 3]| [255 - r, 255 - g, 255 - b];
    // As bright as the floor.
    let coloured = |[grey, ..]: [u8; 3]| [70 + grey / 2, 170 - grey / 3, 60 + grey / 3];
    let red = ColourRange::Rgb { min: [120, 0, 0], max: [255, 135, 255] };
    type Paint = fn([u8; 3]) -> [u8; 3];
    let cases: [(_, _, Paint); 2] = [(ColourRange::Auto, true, dark), (red, false, coloured)];
    for (colour, inverted, paint) in cases {
        let mut params = recognize::Params::default();
        params.binarize.iter_mut().for_each(|range| (range.colour, range.inverted) = (colour, inverted));
        let mut recognizer = Recognizer::new(params, rig, vec![rod.clone()]).unwrap();
        let pairs = pairs_with(|bright| {
            let pixels = (0..480 * 640).flat_map(|at| paint(bright.rgb(at % 640, at / 640)));
            Frame::from_rgb(640, 480, pixels.collect())
        });
        let mut found = Recognition::default();
        let mut run = |pair: &FramePair| {
            recognizer.run(pair, Budget::Iterations(100_000), 1, &mut found).unwrap();
            found.parts.len()
        };
        run(&pairs[0]);
        let mut parts = 0;
        assert_eq!(allocations_of(|| parts = pairs.iter().map(&mut run).sum()), 0, "{colour:?}");
        assert!(parts > 20, "{colour:?}: {parts}");
    }
}

#[test]
fn a_heap_after_a_few_parts_wants_no_allocation() {
    let replay = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("replay");
    let rod = Part::read(replay.join("parts/rod-90.toml")).unwrap();
    let [few, heap] = [2, 10].map(|each_way| DrawnPair::lattice(&PoseModel::new(&rod), each_way));
    let mut recognizer = Recognizer::new(Default::default(), few.rig, vec![rod]).unwrap();
    let [few, heap] = [few, heap].map(|DrawnPair { frames: [left, right], .. }| FramePair { left, right });
    let mut found = Recognition::with_room();
    let mut run = |pair: &FramePair| {
        recognizer.run(pair, Budget::Iterations(20_000), 1, &mut found).unwrap();
        found.parts.len()
    };
    assert_eq!(run(&few), 4);
    let mut parts = 0;
    assert_eq!(allocations_of(|| parts = run(&heap)), 0);
    assert!(parts > 10, "{parts}");
}
