//! Command line and cell → what recognition is built of.

use std::path::{Path, PathBuf, absolute};
use std::time::Duration;

use nalgebra::Isometry3;

use super::args::RecognizeArgs;
use super::error::RecognizeError;
use crate::commands::pictures::{PairFiles, pairs_of};
use crate::config::{Backend, Cell, Gate, SearchMethod};
use crate::part::Part;
use crate::recognize::Params;
use crate::rig::Rig;
use crate::session::RecordedPicture;
use crate::time::{Budget, Timestamp};
use crate::vision::binarize;

/// How long a search may go on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Limit {
    /// From when the pictures are read.
    Deadline(Duration),
    /// Iterations.
    Iterations(u64),
}

/// Specks of fewer pixels are dropped where nothing else is said.
const SPECK_PX_MIN: u32 = 20;
/// Time for a pair where nothing else is said.
const DEADLINE: Duration = Duration::from_millis(30);

impl Limit {
    pub(super) fn budget(self) -> Budget {
        match self {
            Limit::Deadline(time) => Budget::Until(Timestamp::now().after(time)),
            Limit::Iterations(n) => Budget::Iterations(n),
        }
    }
}

/// Everything that is the same for all pairs.
pub(super) struct Setup {
    pub(super) params: Params,
    pub(super) rig: Rig,
    pub(super) parts: Vec<Part>,
    pub(super) limit: Limit,
    pub(super) seed: u64,
    /// Threads that share the two pictures of a pair, 1 or 2.
    pub(super) threads: u8,
    pub(super) base_from_left: Option<Isometry3<f64>>,
    /// The cell, where it is its region that is looked at.
    pub(super) region_of: Option<Cell>,
    pub(super) pairs: Vec<PairFiles>,
    /// Whether a folder was given: a bad pair is then a line, not the end.
    pub(super) many: bool,
}

impl Setup {
    /// Reads all files but the pictures.
    pub(super) fn new(args: &RecognizeArgs) -> Result<Self, RecognizeError> {
        let cell = args.cell.as_deref().map(Cell::read).transpose()?;
        let cell = cell.as_ref();
        let calibration = args.calibration.as_ref().or(cell.map(|c| &c.rig.calibration));
        let parts =
            if args.parts.is_empty() { cell.map(|c| &c.recognition.parts) } else { Some(&args.parts) };
        let calibration = calibration.ok_or(RecognizeError::NoCell { missing: "calibration" })?;
        let parts = parts.ok_or(RecognizeError::NoCell { missing: "part" })?;
        let rig = Rig::read(calibration)?;
        if let Some(doubt) = rig.doubt() {
            tracing::warn!("{}: {doubt}", calibration.display());
        }
        let parts = Part::read_all(parts)?;
        let (pairs, many) = pictures(args, cell)?;
        let recognition = cell.map(|c| &c.recognition);
        Ok(Self {
            params: params(args, cell),
            rig,
            parts,
            limit: limit(args, cell),
            seed: args.seed.or(recognition.map(|r| r.seed)).unwrap_or(1),
            threads: args.threads.or(recognition.map(|r| r.threads)).unwrap_or(1),
            base_from_left: cell.and_then(|c| c.rig.base_from_left),
            region_of: cell.filter(|_| args.region_px.is_none()).cloned(),
            pairs,
            many,
        })
    }
}

fn pictures(args: &RecognizeArgs, cell: Option<&Cell>) -> Result<(Vec<PairFiles>, bool), RecognizeError> {
    if let (Some(left), Some(right)) = (&args.left, &args.right) {
        let name = pair_name(left, right);
        let files = [left, right].map(|path| vec![RecordedPicture::File(path.clone())]);
        return Ok((vec![PairFiles { name, folder: PathBuf::new(), files }], false));
    }
    let session =
        cell.filter(|c| c.cameras.backend == Backend::Replay).and_then(|c| c.cameras.session.as_ref());
    let folder = args.pairs.as_ref().or(session).ok_or(RecognizeError::NoPictures)?;
    Ok((pairs_of(folder)?, true))
}

/// The name of a pair: that of the left picture, or, where the pictures have but their sides' names, of its folder, as with
/// `--pairs`.
fn pair_name(left: &Path, right: &Path) -> String {
    let has_side = |path: &Path, side: &str| path.file_stem().is_some_and(|stem| stem == side);
    let folder = absolute(left).ok().and_then(|left| Some(left.parent()?.file_name()?.to_owned()));
    let name = match folder {
        Some(folder) if has_side(left, "left") && has_side(right, "right") => folder,
        _ => left.file_stem().unwrap_or_default().to_owned(),
    };
    name.to_string_lossy().into_owned()
}

fn limit(args: &RecognizeArgs, cell: Option<&Cell>) -> Limit {
    if let Some(n) = args.iterations {
        return Limit::Iterations(n);
    }
    if let Some(ms) = args.deadline_ms {
        return Limit::Deadline(Duration::from_secs_f64(ms / 1000.0));
    }
    match cell {
        Some(cell) => match cell.recognition.iterations {
            Some(n) => Limit::Iterations(n),
            None => Limit::Deadline(cell.deadline.unwrap_or(DEADLINE)),
        },
        None => Limit::Deadline(DEADLINE),
    }
}

fn params(args: &RecognizeArgs, cell: Option<&Cell>) -> Params {
    let mut params = cell.map_or_else(plain, Cell::recognition_params);
    for pixels in &mut params.binarize {
        if let Some(colour) = colour(args) {
            pixels.colour = colour;
        }
        if let Some(least) = args.min_speck_px {
            pixels.speck_px_min = least;
        }
        if let Some(region) = &args.region_px {
            pixels.region_px.clone_from(region);
        }
        pixels.inverted |= args.inverted;
    }
    if let Some(thin) = args.thin {
        params.thin.algorithm = thin.into();
    }
    if let Some(search) = args.search {
        params.search.method = SearchMethod::from(search).into();
    }
    if let Some(gate) = args.gate {
        params.gate.mode = Gate::from(gate).into();
    }
    params
}

/// The parameters where there is no cell.
fn plain() -> Params {
    let mut params = Params::default();
    params.binarize.iter_mut().for_each(|pixels| pixels.speck_px_min = SPECK_PX_MIN);
    params
}

/// The colours of the command line, if any are given.
fn colour(args: &RecognizeArgs) -> Option<binarize::ColourRange> {
    if args.color.is_some() {
        return Some(binarize::ColourRange::Auto);
    }
    if args.color_min.is_some() || args.color_max.is_some() {
        let [min, max] =
            [(args.color_min, 0), (args.color_max, 255)].map(|(c, end)| c.map_or([end; 3], |c| c.0));
        return Some(binarize::ColourRange::Rgb { min, max });
    }
    if args.grey_min.is_some() || args.grey_max.is_some() {
        let (min, max) = (args.grey_min.unwrap_or(0), args.grey_max.unwrap_or(255));
        return Some(binarize::ColourRange::Grey { min, max });
    }
    None
}
