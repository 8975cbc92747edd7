//! `pickcell accuracy`: recognises scenes with known truth and prints how near it came.

use std::io::{self, Write};
use std::path::PathBuf;

use crate::accuracy::score::{Score, Verdict};
use crate::accuracy::truth::{self, Scene, SceneSet, Truth};
use crate::commands::pictures::{PairFiles, read_pair};
use crate::commands::recognize::output::PairResult;
use crate::commands::whole;
use crate::files::{can_write, write_atomically, write_remedy};
use crate::part::{Part, PartError};
use crate::recognize::{Params, Recognition, Recognizer};
use crate::rig::Rig;
use crate::session::RecordedPicture;
use crate::time::Budget;

/// Recognise scenes with known truth and print how near it came.
///
/// Example: pickcell accuracy ../shared/scenes --out out/accuracy
#[derive(clap::Args, Debug)]
pub struct Accuracy {
    /// Folder with sets/SET/scene-NN and parts/, or with sequences (left/, right/, truth/).
    pub root: PathBuf,
    /// Only these sets.
    #[arg(long = "set")]
    pub sets: Vec<String>,
    /// Folder of the part files; default: parts/ below ROOT.
    #[arg(long)]
    pub parts: Option<PathBuf>,
    /// Iterations of the search.
    #[arg(long, default_value_t = 1_000_000, allow_hyphen_values = true, value_parser = whole::<u64>(1, u64::MAX))]
    pub iterations: u64,
    /// Random seed.
    #[arg(long, default_value_t = 1, allow_hyphen_values = true, value_parser = whole::<u64>(0, u64::MAX))]
    pub seed: u64,
    /// As if the right camera had turned since the rig was calibrated, by so many pixels across the baseline.
    #[arg(long, value_name = "PX", default_value_t = 0.0, allow_negative_numbers = true, value_parser = turned_px)]
    pub turned_px: f64,
    /// Write OUT/SET/SCENE/results.json, as score.py reads them.
    #[arg(long)]
    pub out: Option<PathBuf>,
    /// A line for every wrong or missed part.
    #[arg(long)]
    pub verbose: bool,
}

fn turned_px(text: &str) -> Result<f64, String> {
    let px = text.parse::<f64>().ok().filter(|px| px.abs() <= 30.0);
    px.ok_or_else(|| "allowed: pixels, -30 to 30".to_owned())
}

/// Runs the command; gives the exit code.
///
/// # Errors
/// Whatever file cannot be used.
pub fn run(args: &Accuracy) -> Result<u8, Box<dyn std::error::Error>> {
    let folder = args.parts.clone().unwrap_or_else(|| args.root.join("parts"));
    let mut total = Score::default();
    let sets = truth::read_sets(&args.root)?;
    if let Some(unknown) = args.sets.iter().find(|name| !sets.iter().any(|set| set.name == **name)) {
        let known: Vec<&str> = sets.iter().map(|set| set.name.as_str()).collect();
        return Err(format!(
            "--set {unknown}: there is no such set in {}; known: {}",
            args.root.display(),
            known.join(", ")
        )
        .into());
    }
    let chosen = sets.into_iter().filter(|set| args.sets.is_empty() || args.sets.contains(&set.name));
    // All part files before the first line: a wrong folder is no table.
    let with_parts = chosen.map(|set| {
        let paths: Vec<PathBuf> = set.parts.iter().map(|p| folder.join(format!("{p}.toml"))).collect();
        Ok((set, Part::read_all(&paths)?))
    });
    let with_parts: Vec<_> = with_parts.collect::<Result<_, PartError>>()?;
    if let Some(out) = &args.out {
        let made = std::fs::create_dir_all(out).and_then(|()| can_write(out));
        made.map_err(|e| format!("--out {}: cannot be written: {e}; {}", out.display(), write_remedy(&e)))?;
    }
    say(Score::HEADING)?;
    let mut refused = 0;
    for (set, parts) in &with_parts {
        let (score, of_set) = run_set(args, set, parts)?;
        say(&score.row(&set.name))?;
        total.merge(&score);
        refused += of_set;
    }
    say(&total.row("**all**"))?;
    Ok(u8::from(refused > 0))
}

/// 1 where a result could not be written, 2 where what was given cannot be used.
pub fn exit_code(error: &(dyn std::error::Error + 'static)) -> u8 {
    if error.is::<io::Error>() { 1 } else { 2 }
}

/// Whoever read the table does not want any more of it.
pub fn is_closed_pipe(error: &(dyn std::error::Error + 'static)) -> bool {
    error.downcast_ref::<io::Error>().is_some_and(|e| e.kind() == io::ErrorKind::BrokenPipe)
}

fn say(line: &str) -> io::Result<()> {
    writeln!(io::stdout().lock(), "{line}")
}

/// The score of a set, and how many of its pairs were refused, of which nothing is found.
fn run_set(
    args: &Accuracy,
    set: &SceneSet,
    parts: &[Part],
) -> Result<(Score, usize), Box<dyn std::error::Error>> {
    let rig = Rig::read(&set.calibration)?;
    let baseline = rig.right_eye().coords.normalize();
    // The pictures stay: it is the calibration that is of before.
    let rig = rig.with_right_turned(&(baseline * (-args.turned_px / rig.right.fy)));
    let mut params = Params::default();
    params.binarize.iter_mut().for_each(|b| {
        b.inverted = set.dark_parts;
        b.speck_px_min = 20;
    });
    let mut recognizer = Recognizer::new(params, rig, parts.to_vec())?;
    let (mut score, mut refused) = (Score::default(), 0);
    for scene in &set.scenes {
        let truth = truth::read_truth(&scene.truth)?;
        let files = PairFiles {
            name: scene.name.clone(),
            folder: set.calibration.with_file_name(&scene.name),
            files: scene.pictures.clone().map(|path| vec![RecordedPicture::File(path)]),
        };
        let (pair, _) = read_pair(&files, recognizer.rig())?;
        let mut found = Recognition::default();
        let run = recognizer.run(&pair, Budget::Iterations(args.iterations), args.seed, &mut found);
        if let Err(refusal) = run {
            tracing::error!("{}/{}: {refusal}", set.name, scene.name);
            found = Recognition::default();
            refused += 1;
        } else if let Some(out) = &args.out {
            let folder = out.join(&set.name).join(&scene.name);
            let result = PairResult::new(Some(&scene.name), &found, parts, "left", &[found.stages]);
            let path = folder.join("results.json");
            std::fs::create_dir_all(&folder)
                .and_then(|()| write_atomically(&path, (result.to_json() + "\n").as_bytes()))
                .map_err(|e| {
                    let remedy = write_remedy(&e);
                    io::Error::new(e.kind(), format!("{}: cannot be written: {e}; {remedy}", path.display()))
                })?;
        }
        let verdicts = score.add(&truth, &found, parts);
        if args.verbose {
            tell(set, scene, &truth, &found, parts, &verdicts)?;
        }
    }
    Ok((score, refused))
}

fn tell(
    set: &SceneSet,
    scene: &Scene,
    truth: &Truth,
    found: &Recognition,
    parts: &[Part],
    verdicts: &[Verdict],
) -> io::Result<()> {
    let name = format!("{}/{}", set.name, scene.name);
    for v in verdicts {
        let f = &found.parts[v.detection];
        let what = match v.object {
            None => "WRONG".to_string(),
            Some((o, mean)) if mean > 1.0 => format!("{mean:.2} mm off, object {o}"),
            _ => continue,
        };
        let nodes: Vec<_> = f.nodes.iter().map(|n| (n.left_px.x.round(), n.left_px.y.round())).collect();
        say(&format!(
            "    {name} #{} {} {what} fitness {:.2} clear {:.2} at {nodes:?}",
            v.detection, parts[f.part].name, f.fitness, f.clear,
        ))?;
    }
    for (o, object) in truth.objects.iter().enumerate() {
        if !verdicts.iter().any(|v| v.object.is_some_and(|(k, _)| k == o)) {
            let visible = object.visible_left.min(object.visible_right);
            say(&format!(
                "    {name} object {o} {} missed, visible {visible:.2} {:?}",
                object.part,
                object.nodes.iter().map(|n| n.left_px).collect::<Vec<_>>()
            ))?;
        }
    }
    Ok(())
}
