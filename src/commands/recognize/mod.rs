//! `pickcell recognize`: parts in one stereo pair, or in every pair of a folder.

mod args;
mod error;
pub(super) mod output;
mod setup;

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::thread::Builder;

pub use args::{RecognizeArgs, corners_as_values};
pub use error::RecognizeError;

use self::args::Format;
use self::output::{PairError, PairResult, to_json};
use self::setup::Setup;
use super::pictures::{PairFiles, decoded, read_pair};
use crate::files::write_atomically;
use crate::frame::{Frame, FramePair};
use crate::hands;
use crate::recognize::{Recognition, Recognizer, Refusal, StageTimes};
use crate::report::overlay::Overlay;
use crate::report::{Canvas, stages};
use crate::vision::binarize::ParamsError;
use crate::vision::decode::Output;

/// Recognises; results go to standard output and to the files that were asked for.
///
/// # Errors
/// [`RecognizeError`]; its exit code says whether the job or what was given to it is to blame.
pub fn run(args: &RecognizeArgs) -> Result<(), RecognizeError> {
    if let Some(path) = &args.overlay {
        check_overlay(path, args)?;
    }
    if let Some(folder) = &args.stages {
        check_stages(folder, args)?;
    }
    let setup = Setup::new(args)?;
    if let Some(path) = args.overlay.clone().filter(|_| setup.many) {
        let problem = "each pair of the session would take the place of the one before; name one with --left and --right, or use --stages";
        return Err(RecognizeError::Overlay { path, problem });
    }
    let recognizer = Recognizer::new(setup.params.clone(), setup.rig, setup.parts.clone());
    let mut recognizer = recognizer.map_err(|error| match (&setup.region_of, &error) {
        // Colours of a cell were looked at when it was read.
        (None, _) | (_, ParamsError::EmptyRange { .. }) => RecognizeError::from(error),
        (Some(cell), _) => cell.region_error(&error, &setup.rig).into(),
    })?;
    if setup.threads > 1 {
        let (owner, helper) = hands::hands().map_err(RecognizeError::System)?;
        Builder::new().spawn(move || helper.work()).map_err(RecognizeError::System)?;
        recognizer.share_with(owner);
    }
    let mut job = Job { args, setup: &setup, recognizer, found: Recognition::default(), runs: Vec::new() };
    let mut failed = 0;
    for pair in &setup.pairs {
        match job.pair(pair) {
            Ok(()) => {}
            Err(e) if setup.many && e.is_of_a_pair() => {
                failed += 1;
                job.tell_error(pair, &e)?;
            }
            Err(e) => return Err(e),
        }
    }
    match failed {
        0 => Ok(()),
        failed => Err(RecognizeError::PairsFailed { failed, pairs: setup.pairs.len() }),
    }
}

/// Name of a pair's results.
const RESULTS: &str = "results.json";
/// Names of what the stages saw: binary, skeleton and graph of the left picture, of the right one, and both with the result.
const STAGE_PICTURES: [&str; 7] = [
    "left-binary.png",
    "left-skeleton.png",
    "left-graph.png",
    "right-binary.png",
    "right-skeleton.png",
    "right-graph.png",
    "overlay.png",
];

/// Whether the overlay may be written to `path`: it takes the place of nothing that is read.
fn check_overlay(path: &Path, args: &RecognizeArgs) -> Result<(), RecognizeError> {
    let refused = |problem| Err(RecognizeError::Overlay { path: path.to_owned(), problem });
    if !path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("png")) {
        return refused("it is a png; give a name that ends so");
    }
    match is_read(path, args) {
        true => refused("this file is read; give another name"),
        false => Ok(()),
    }
}

/// Whether the pictures of the stages may be written into `folder`: they take the place of nothing that is read.
fn check_stages(folder: &Path, args: &RecognizeArgs) -> Result<(), RecognizeError> {
    match STAGE_PICTURES.iter().map(|name| folder.join(name)).find(|path| is_read(path, args)) {
        Some(path) => Err(RecognizeError::Stages { path }),
        None => Ok(()),
    }
}

fn is_read(path: &Path, args: &RecognizeArgs) -> bool {
    let inputs =
        args.left.iter().chain(&args.right).chain(&args.cell).chain(&args.calibration).chain(&args.parts);
    let mut inputs = inputs.filter_map(|input| input.canonicalize().ok());
    path.canonicalize().is_ok_and(|there| inputs.any(|input| input == there))
}

/// Removes what an earlier run wrote, so that it does not seem to be from this one.
fn remove_file(path: &Path) -> Result<(), RecognizeError> {
    fs::remove_file(path).or_else(|source| match source.kind() {
        io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => Ok(()),
        _ => Err(RecognizeError::Write { path: path.to_owned(), source }),
    })
}

/// The work on all pairs.
struct Job<'a> {
    args: &'a RecognizeArgs,
    setup: &'a Setup,
    recognizer: Recognizer,
    found: Recognition,
    runs: Vec<StageTimes>,
}

impl Job<'_> {
    fn pair(&mut self, pair: &PairFiles) -> Result<(), RecognizeError> {
        if let Some(folder) = &self.args.out {
            remove_file(&folder.join(&pair.name).join(RESULTS))?;
        }
        if let Some(folder) = self.stages_folder(pair) {
            STAGE_PICTURES.iter().try_for_each(|name| remove_file(&folder.join(name)))?;
        }
        let (frames, paths) = read_pair(pair, &self.setup.rig)?;
        self.runs.clear();
        for _ in 0..self.args.repeat {
            let budget = self.setup.limit.budget();
            self.recognizer
                .run(&frames, budget, self.setup.seed, &mut self.found)
                .map_err(|reason| refused(reason, &frames, &paths))?;
            self.runs.push(self.found.stages);
        }
        self.write_pictures(pair, &frames, &paths)?;
        let name = self.setup.many.then_some(pair.name.as_str());
        let frame = if self.setup.base_from_left.is_some() { "base" } else { "left" };
        let result = PairResult::new(name, &self.found, &self.setup.parts, frame, &self.runs);
        if let Some(folder) = &self.args.out {
            write_file(&folder.join(&pair.name), RESULTS, (result.to_json() + "\n").as_bytes())?;
        }
        let mut text = Vec::new();
        match self.args.format {
            Format::Json => text.extend((result.to_json() + "\n").bytes()),
            Format::Text => result.write_text(&mut text).map_err(RecognizeError::Stdout)?,
        }
        print(&text)
    }

    /// The pictures of the stages and the overlay, where asked for.
    fn write_pictures(
        &self,
        pair: &PairFiles,
        frames: &FramePair,
        paths: &[PathBuf; 2],
    ) -> Result<(), RecognizeError> {
        if self.args.overlay.is_none() && self.args.stages.is_none() {
            return Ok(());
        }
        let in_colour = |frame, path: &PathBuf| decoded(frame, path, Output::Rgb);
        let raw = [in_colour(&frames.left, &paths[0])?, in_colour(&frames.right, &paths[1])?];
        let overlay = self.overlay(&raw);
        if let Some(path) = &self.args.overlay {
            let folder = path.parent().unwrap_or(Path::new(""));
            write_png(folder, &path.file_name().unwrap_or_default().to_string_lossy(), &overlay)?;
        }
        let Some(folder) = self.stages_folder(pair) else { return Ok(()) };
        let of_sides = self.recognizer.pictures().each_ref().map(|picture| {
            [
                stages::bits(picture.whole_mask()),
                stages::bits(picture.skeleton()),
                stages::graph(picture.mask(), picture.graph()),
            ]
        });
        let pictures = of_sides.iter().flatten().chain([&overlay]);
        STAGE_PICTURES.iter().zip(pictures).try_for_each(|(name, picture)| write_png(&folder, name, picture))
    }

    /// Where the pictures of a pair's stages go, where asked for.
    fn stages_folder(&self, pair: &PairFiles) -> Option<PathBuf> {
        let folder = self.args.stages.as_ref()?;
        Some(if self.setup.many { folder.join(&pair.name) } else { folder.clone() })
    }

    fn overlay(&self, raw: &[Frame; 2]) -> Canvas {
        let [left, right] = self.recognizer.pictures();
        let caption = self.found.no_pick.map(|reason| format!("no pick: {reason}")).unwrap_or_default();
        let overlay = Overlay {
            frames: [&raw[0], &raw[1]],
            graphs: [left, right].map(|picture| (picture.graph(), picture.halvings())),
            rig: &self.found.rig(&self.setup.rig),
            parts: &self.setup.parts,
            found: &self.found.parts,
            base_from_left: self.setup.base_from_left.unwrap_or_default(),
            caption: &caption,
        };
        overlay.draw()
    }

    /// The line of a bad pair.
    fn tell_error(&self, pair: &PairFiles, e: &RecognizeError) -> Result<(), RecognizeError> {
        let line = match self.args.format {
            Format::Json => to_json(&PairError { pair: &pair.name, error: e.to_string() }),
            Format::Text => format!("pair {}: error: {e}", pair.name),
        };
        print((line + "\n").as_bytes())
    }
}

/// What the recogniser refused, with the file's name and, for a damaged picture, the decoder's reason.
fn refused(reason: Refusal, frames: &FramePair, paths: &[PathBuf; 2]) -> RecognizeError {
    if let Refusal::Damaged { .. } = reason {
        for (frame, path) in [(&frames.left, &paths[0]), (&frames.right, &paths[1])] {
            // Some pictures give colours, but no luma.
            for output in [Output::Rgb, Output::Grey] {
                if let Err(e) = decoded(frame, path, output) {
                    return e;
                }
            }
        }
    }
    let [left, right] = paths.clone();
    RecognizeError::Refused { left, right, reason }
}

fn print(text: &[u8]) -> Result<(), RecognizeError> {
    let mut out = io::stdout().lock();
    out.write_all(text).and_then(|()| out.flush()).map_err(RecognizeError::Stdout)
}

fn write_png(folder: &Path, name: &str, picture: &Canvas) -> Result<(), RecognizeError> {
    let png = picture.to_png();
    let png = png.map_err(|source| RecognizeError::Write { path: folder.join(name), source })?;
    write_file(folder, name, &png)
}

/// Writes a file, and its folder where it is not there.
fn write_file(folder: &Path, name: &str, bytes: &[u8]) -> Result<(), RecognizeError> {
    let path = folder.join(name);
    let is_here = folder.as_os_str().is_empty();
    let made = if is_here { Ok(()) } else { fs::create_dir_all(folder) };
    let written = made.and_then(|()| write_atomically(&path, bytes));
    written.map_err(|source| RecognizeError::Write { path, source })
}
