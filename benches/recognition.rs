//! A whole recognition on one core, camera bytes to ranked grasps: `cargo bench --bench recognition`.
//!
//! Scenes of `../shared/scenes` where they lie beside this folder, else the recorded session: as a camera without
//! compression sends them, and as JPEG. A pair counts with the median of its runs; the table has the median and the 99th
//! percentile of the pairs. Below it the figure that has a goal.

use std::path::Path;

use pickcell::accuracy::score::percentile;
use pickcell::accuracy::truth::{Scene, SceneSet, read_sets, read_truth};
use pickcell::frame::{ColourEncoding, Frame, FramePair, PixelFormat, QuantizationRange};
use pickcell::part::Part;
use pickcell::recognize::{Params, Recognition, Recognizer, StageTimes};
use pickcell::rig::Rig;
use pickcell::session::RecordedPicture;
use pickcell::time::Budget;

const ITERATIONS: u64 = 1_000_000;
/// Rods of the scenes that have a goal.
const GOAL_RODS: usize = 10;

/// In which form a camera sends a picture.
#[derive(Clone, Copy, PartialEq)]
enum Form {
    Rgb,
    Yuyv,
    Jpeg,
}

const FORMS: [(Form, &str); 3] = [(Form::Rgb, "RGB"), (Form::Yuyv, "YUYV"), (Form::Jpeg, "JPEG")];

impl Form {
    /// A recorded picture in this form; `None` where it would be a JPEG and is not.
    fn of(self, path: &Path) -> Option<Frame> {
        let recorded = RecordedPicture::File(path.into());
        if self == Self::Jpeg {
            return Some(recorded.read().expect("a picture")).filter(|f| f.format == PixelFormat::Mjpeg);
        }
        let raw = recorded.read_raw().expect("a whole picture");
        let (width, height) = (raw.width, raw.height);
        let places = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        if self == Self::Rgb {
            let bytes = places.flat_map(|(x, y)| raw.rgb(x, y)).collect();
            return Some(Frame::from_rgb(width, height, bytes));
        }
        Some(Frame {
            bytes: places.flat_map(|(x, y)| [raw.luma(x, y), 128]).collect(),
            format: PixelFormat::Yuyv,
            encoding: ColourEncoding { range: QuantizationRange::Full, ..ColourEncoding::default() },
            stride_bytes: 2 * width,
            width,
            height,
            ..Frame::default()
        })
    }
}

/// The stages of a pair, each the median of its runs, in microseconds.
struct Times {
    form: Form,
    rods: Option<usize>,
    total_us: f64,
    stages_us: [f64; 5],
}

fn stages_us(t: &StageTimes) -> [f64; 5] {
    [t.binarize_ns, t.thin_ns, t.graph_ns, t.match_ns, t.pose_ns].map(|ns| ns as f64 / 1e3)
}

fn time(
    recognizer: &mut Recognizer,
    scene: &Scene,
    parts: &[Part],
    form: Form,
    runs: usize,
) -> Option<Times> {
    let [left, right] = scene.pictures.each_ref().map(|path| form.of(path));
    let pair = FramePair { left: left?, right: right? };
    let mut found = Recognition::with_room();
    let mut all = Vec::new();
    for run in 0..=runs {
        recognizer.run(&pair, Budget::Iterations(ITERATIONS), 1, &mut found).expect("a good pair");
        // The first run fills the caches.
        if run > 0 {
            all.push(found.stages);
        }
    }
    let median = |of: &dyn Fn(&StageTimes) -> f64| percentile(&all.iter().map(of).collect::<Vec<_>>(), 0.5);
    let rods_only = parts.iter().all(|part| part.name.starts_with("rod"));
    let objects = || read_truth(&scene.truth).expect("truth").objects.len();
    Some(Times {
        form,
        rods: rods_only.then(objects),
        total_us: median(&|t| t.total_ns as f64 / 1e3),
        stages_us: std::array::from_fn(|k| median(&|t| stages_us(t)[k])),
    })
}

fn times(root: &Path, set: &SceneSet, short: bool) -> Vec<Times> {
    let rig = Rig::read(&set.calibration).expect("a calibration");
    let paths: Vec<_> = set.parts.iter().map(|part| root.join(format!("parts/{part}.toml"))).collect();
    let parts = Part::read_all(&paths).expect("part files");
    let mut params = Params::default();
    params.binarize.iter_mut().for_each(|range| range.inverted = set.dark_parts);
    let mut recognizer = Recognizer::new(params, rig, parts.clone()).expect("good parameters");
    let (scenes, runs) = if short { (&set.scenes[..1], 1) } else { (&set.scenes[..], 15) };
    let forms = || FORMS.iter().map(|(form, _)| *form);
    let pairs = scenes.iter().flat_map(|scene| forms().map(move |form| (scene, form)));
    pairs.filter_map(|(scene, form)| time(&mut recognizer, scene, &parts, form, runs)).collect()
}

/// Median and 99th percentile.
fn two(values: &[f64]) -> String {
    if values.is_empty() {
        return "-".into();
    }
    format!("{:.0} · {:.0}", percentile(values, 0.5), percentile(values, 0.99))
}

fn row(name: &str, times: &[&Times]) {
    let of = |form: Form| times.iter().filter(move |t| t.form == form);
    print!("| {name} | {} |", of(Form::Rgb).count());
    for (form, _) in FORMS {
        print!(" {} |", two(&of(form).map(|t| t.total_us).collect::<Vec<_>>()));
    }
    for stage in 0..5 {
        let stage_us: Vec<f64> = of(Form::Rgb).map(|t| t.stages_us[stage]).collect();
        print!(" {:.0} |", percentile(&stage_us, 0.5));
    }
    println!();
}

fn main() {
    // `cargo test --benches` only wants to know that it runs
    let short = !std::env::args().any(|a| a == "--bench");
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let roots = [here.join("../shared/scenes"), here.join("replay")];
    let root = roots.iter().find(|root| root.is_dir()).expect("the recorded session");
    println!(
        "A whole recognition on one core, microseconds, median · 99th percentile of the pairs; stages of RGB, median\n"
    );
    print!("| scenes | pairs |");
    FORMS.iter().for_each(|(_, name)| print!(" {name} |"));
    println!(" binarize | thin | graph | match | pose |\n|{}", "---|".repeat(10));
    let mut all = Vec::new();
    for set in read_sets(root).expect("scenes") {
        let times = times(root, &set, short);
        row(&set.name, &times.iter().collect::<Vec<_>>());
        all.extend(times);
    }
    row("all", &all.iter().collect::<Vec<_>>());
    let ten: Vec<&Times> = all.iter().filter(|t| t.rods == Some(GOAL_RODS)).collect();
    row(&format!("{GOAL_RODS} rods"), &ten);
    let us: Vec<f64> = ten.iter().filter(|t| t.form == Form::Rgb).map(|t| t.total_us).collect();
    println!("\n| goal | | measured |\n|---|---|---|");
    println!("| {GOAL_RODS} rods, RGB, one core | 300 · 600 us | {} us |", two(&us));
}
