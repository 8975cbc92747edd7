//! What can stop `pickcell recognize`.

use std::io;
use std::path::PathBuf;

use crate::config::ConfigError;
use crate::files::{is_full, write_remedy};
use crate::part::PartError;
use crate::recognize;
use crate::rig::RigError;
use crate::session::{PictureError, SessionError};
use crate::vision::binarize::ParamsError;
use crate::vision::decode::DecodeError;

/// Why a pair, or all of them, could not be recognised.
#[derive(Debug, thiserror::Error)]
pub enum RecognizeError {
    /// The cell's file.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The calibration.
    #[error(transparent)]
    Rig(#[from] RigError),
    /// A part file.
    #[error(transparent)]
    Part(#[from] PartError),
    /// Colour range or region of the command line.
    #[error("{}", in_options(.0))]
    Params(#[from] ParamsError),
    /// The system has no descriptor or thread left.
    #[error("--threads 2: the system refuses a second thread: {0}; use --threads 1")]
    System(io::Error),
    /// Neither a cell nor what it would give.
    #[error(
        "no {missing}: give --cell FILE, which names all of it, or --calibration FILE and --part FILE; and the pictures: --left and \
         --right, or --pairs"
    )]
    NoCell {
        /// `calibration` or `part`.
        missing: &'static str,
    },
    /// No pictures were named.
    #[error("no pictures: give --left and --right, or --pairs with a folder of pairs")]
    NoPictures,
    /// A folder that cannot be listed.
    #[error("{}: cannot read it: {source}; give --pairs a folder of pairs, or a recording (.mcap)", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// No pair in a folder.
    #[error("{}: no pair in it; it must hold folders with left.png|jpg and right.png|jpg, or folders left/ and right/ with pictures of equal names", path.display())]
    NoPairs {
        /// The folder.
        path: PathBuf,
    },
    /// One of the two pictures is not there.
    #[error("{}: the {side} picture of this pair is missing; a pair is two pictures, png or jpg", path.display())]
    MissingPicture {
        /// Where it is looked for.
        path: PathBuf,
        /// `left` or `right`.
        side: &'static str,
    },
    /// Two pictures that could be the one.
    #[error("{} and {}: both for the {side} picture of this pair; leave one of them there", path.display(), other.display())]
    TwoPictures {
        /// The first in the alphabet.
        path: PathBuf,
        /// The second.
        other: PathBuf,
        /// `left` or `right`.
        side: &'static str,
    },
    /// A device, pipe or folder in place of a picture.
    #[error("{}: is no regular file; give a png or jpg picture", path.display())]
    NoFile {
        /// The path.
        path: PathBuf,
    },
    /// A picture file that cannot be used.
    #[error(transparent)]
    Picture(#[from] PictureError),
    /// A recording that cannot be used.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// A JPEG that cannot be decoded.
    #[error("{}: {reason}", path.display())]
    Decode {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: DecodeError,
    },
    /// A picture of another size than the calibration's.
    #[error("{}: {reason}", path.display())]
    Size {
        /// The picture.
        path: PathBuf,
        /// Both sizes and what to do.
        reason: RigError,
    },
    /// The recogniser refused the pair.
    #[error("{} and {}: {reason}", left.display(), right.display())]
    Refused {
        /// Left picture.
        left: PathBuf,
        /// Right picture.
        right: PathBuf,
        /// Why.
        reason: recognize::Refusal,
    },
    /// The overlay cannot have this name.
    #[error("--overlay {}: {problem}", path.display())]
    Overlay {
        /// The name.
        path: PathBuf,
        /// Why not, and what to do.
        problem: &'static str,
    },
    /// The pictures of the stages would take the place of an input.
    #[error("--stages: {}: this file is read; give another folder", path.display())]
    Stages {
        /// The input.
        path: PathBuf,
    },
    /// A result that cannot be written.
    #[error("{}: cannot be written: {source}; {}", path.display(), write_remedy(source))]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Standard output is gone.
    #[error("standard output: {0}")]
    Stdout(io::Error),
    /// Pairs of a folder that failed; each has had its line.
    #[error("{failed} of {pairs} pairs could not be recognised; their lines say why")]
    PairsFailed {
        /// How many failed.
        failed: usize,
        /// Of how many.
        pairs: usize,
    },
}

impl RecognizeError {
    /// 1 where the job failed, 2 where what was given to it cannot be used.
    pub fn exit_code(&self) -> u8 {
        match self {
            RecognizeError::Stdout(_) | RecognizeError::PairsFailed { .. } => 1,
            // The next call may find room.
            RecognizeError::Write { source, .. } if is_full(source) => 1,
            _ => 2,
        }
    }

    /// Whether it is about one pair, so that others may do.
    pub fn is_of_a_pair(&self) -> bool {
        self.exit_code() == 2 && !matches!(self, RecognizeError::Write { .. })
    }

    /// Whether whoever read standard output has closed it (`| head`), which is no failure.
    pub fn is_closed_pipe(&self) -> bool {
        matches!(self, RecognizeError::Stdout(e) if e.kind() == io::ErrorKind::BrokenPipe)
    }
}

/// What is wrong with colours or region, with the options in place of the keys.
fn in_options(error: &ParamsError) -> String {
    let keys = ["region_px", "grey_min/grey_max", "color_min/color_max"];
    let options = ["--region-px", "--grey-min/--grey-max", "--color-min/--color-max"];
    keys.iter().zip(options).fold(error.to_string(), |text, (key, option)| text.replace(key, option))
}
