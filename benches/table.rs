//! `cargo bench --bench table`: medians of the pixel stages in one table, and beside them OpenCV, scikit-image and
//! skan on the same pictures in the same run, where Python has them. The pictures are left in `target/bench`.

mod drawn;
mod stages;

use pickcell::level::Level;
use pickcell::vision::thin::Algorithm;
use serde::Deserialize;
use stages::{Eye, SecondCore, Waits};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

const PICTURES: [(usize, usize, usize); 3] = [(640, 480, 20), (1920, 1080, 20), (1920, 1080, 100)];

/// A row: what, by whom, microseconds a picture of [`PICTURES`].
struct Row {
    job: &'static str,
    who: String,
    median_us: [Option<f64>; PICTURES.len()],
}

/// One figure of `peers.py`.
#[derive(Deserialize)]
struct Peer {
    job: String,
    who: String,
    picture: String,
    median_us: f64,
}

fn main() {
    // `cargo test --benches` runs this too: it is a bench, not a test.
    if std::env::args().any(|a| a == "--test") || !std::env::args().any(|a| a == "--bench") {
        return;
    }
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("../bench");
    let mut rows = Vec::new();
    for (i, &(width, height, rods)) in PICTURES.iter().enumerate() {
        let pair = drawn::pair(width, height, rods, 1);
        measure(&mut rows, i, &pair);
        write_pictures(&folder, i, &pair);
    }
    rows.extend(peers(&folder));
    print(&rows);
}

fn stem(i: usize) -> String {
    let (width, height, rods) = PICTURES[i];
    format!("{width}x{height}-{rods}")
}

/// Median time of many runs, in microseconds.
fn median_us(mut work: impl FnMut()) -> f64 {
    const RUNS: usize = 301;
    let mut times: Vec<f64> = (0..RUNS)
        .map(|_| {
            let begin = Instant::now();
            work();
            begin.elapsed().as_secs_f64() * 1e6
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[RUNS / 2]
}

fn put(rows: &mut Vec<Row>, job: &'static str, who: &str, i: usize, us: f64) {
    let row = match rows.iter_mut().position(|r| r.job == job && r.who == who) {
        Some(at) => &mut rows[at],
        None => {
            rows.push(Row { job, who: who.to_string(), median_us: [None; PICTURES.len()] });
            rows.last_mut().expect("just pushed")
        }
    };
    row.median_us[i] = Some(us);
}

const BINARIZE: &str = "RGB to bits";
const ZHANG_SUEN: &str = "thin, Zhang-Suen";
const GUO_HALL: &str = "thin, Guo-Hall";
const GRAPH: &str = "skeleton to graph";
const PAIR: &str = "two RGB pictures to two graphs";

fn measure(rows: &mut Vec<Row>, i: usize, [left, right]: &[pickcell::frame::Frame; 2]) {
    let (width, height, _) = PICTURES[i];
    for &level in Level::available().iter().rev() {
        let who = format!("pickcell {}", level.name());
        let mut eye = Eye::new(width, height, Algorithm::ZhangSuen, level);
        put(rows, BINARIZE, &who, i, median_us(|| eye.binarize(left)));
        put(rows, ZHANG_SUEN, &who, i, median_us(|| eye.thin()));
        let mut guo_hall = Eye::new(width, height, Algorithm::GuoHall, level);
        guo_hall.binarize(left);
        put(rows, GUO_HALL, &who, i, median_us(|| guo_hall.thin()));
        put(rows, GRAPH, &who, i, median_us(|| eye.graph(left)));
        let mut other = Eye::new(width, height, Algorithm::ZhangSuen, level);
        let one_core = median_us(|| {
            eye.run(left);
            other.run(right);
        });
        put(rows, PAIR, &format!("{who}, one core"), i, one_core);
        for (waits, how) in [(Waits::Asleep, "two cores"), (Waits::Awake, "two cores, spinning")] {
            let other = Eye::new(width, height, Algorithm::ZhangSuen, level);
            let mut second = SecondCore::new(waits, other, right.clone());
            put(rows, PAIR, &format!("{who}, {how}"), i, median_us(|| second.run(&mut eye, left)));
        }
    }
}

/// What the peers read: the left picture as RGB and its mask.
fn write_pictures(folder: &Path, i: usize, [left, _]: &[pickcell::frame::Frame; 2]) {
    let (width, height, _) = PICTURES[i];
    let mut eye = Eye::new(width, height, Algorithm::ZhangSuen, Level::detect());
    eye.run(left);
    let (w, h) = (width as u32, height as u32);
    let save = || -> Result<(), String> {
        std::fs::create_dir_all(folder).map_err(|e| e.to_string())?;
        let path = |kind: &str| folder.join(format!("{}-{kind}.png", stem(i)));
        let rgb = image::RgbImage::from_raw(w, h, left.bytes.clone()).expect("as many bytes as pixels");
        rgb.save(path("rgb")).map_err(|e| e.to_string())?;
        for (kind, bits) in [("mask", &eye.mask), ("skeleton", &eye.skeleton)] {
            let grey = image::GrayImage::from_raw(w, h, bits.to_grey()).expect("as many bytes as pixels");
            grey.save(path(kind)).map_err(|e| e.to_string())?;
        }
        Ok(())
    };
    if let Err(error) = save() {
        eprintln!("{}: {error}", folder.display());
    }
}

/// Figures of other people's code, where Python is there and has it.
fn peers(folder: &Path) -> Vec<Row> {
    let script: PathBuf = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/peers.py");
    let stems = (0..PICTURES.len()).map(stem);
    let output = match Command::new("python3").arg(script).arg(folder).args(stems).output() {
        Ok(output) => output,
        Err(error) => {
            println!("without other people's code: python3 does not start: {error}");
            return Vec::new();
        }
    };
    eprint!("{}", String::from_utf8_lossy(&output.stderr));
    let mut rows = Vec::new();
    for line in String::from_utf8_lossy(&output.stdout).lines() {
        let Ok(peer) = serde_json::from_str::<Peer>(line) else { continue };
        let job = [BINARIZE, ZHANG_SUEN, GUO_HALL, GRAPH].into_iter().find(|&j| j == peer.job);
        let picture = (0..PICTURES.len()).find(|&i| stem(i) == peer.picture);
        if let (Some(job), Some(picture)) = (job, picture) {
            put(&mut rows, job, &peer.who, picture, peer.median_us);
        }
    }
    rows
}

/// The table; a peer's figure with its ratio to the first row of the same job.
fn print(rows: &[Row]) {
    let titles = PICTURES.map(|(w, h, rods)| format!("{w}x{h}, {rods} rods"));
    println!("\nmedian, microseconds (times the first row of the same job)\n");
    println!("| {:30} | {:30} | {} |", "job", "by", titles.map(|t| format!("{t:>22}")).join(" | "));
    println!("|{}", "---|".repeat(2 + PICTURES.len()));
    for job in [BINARIZE, ZHANG_SUEN, GUO_HALL, GRAPH, PAIR] {
        let mut first: Option<&Row> = None;
        for row in rows.iter().filter(|r| r.job == job) {
            let cells: Vec<String> = (0..PICTURES.len())
                .map(|i| {
                    let Some(us) = row.median_us[i] else { return format!("{:>22}", "-") };
                    match first.and_then(|f| f.median_us[i]) {
                        Some(best) => format!("{us:>12.1} ({:>6.1}x)", us / best),
                        None => format!("{us:>12.1}          "),
                    }
                })
                .collect();
            println!("| {:30} | {:30} | {} |", row.job, row.who, cells.join(" | "));
            first = first.or(Some(row));
        }
    }
}
