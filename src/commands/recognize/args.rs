//! What can be said on the command line of `pickcell recognize`.

use std::ffi::OsString;
use std::path::PathBuf;

use clap::{Args, ValueEnum};

use crate::commands::whole;
use crate::config::{Gate, SearchMethod};
use crate::vision::thin::Algorithm;

const EXAMPLES: &str = "\
Examples:
  pickcell recognize --calibration replay/conveyor/calibration.yaml --part replay/parts/rod-90.toml \\
                     --left replay/conveyor/left/0000.jpg --right replay/conveyor/right/0000.jpg --overlay out/pair.png
  pickcell recognize --calibration replay/conveyor/calibration.yaml --part replay/parts/rod-90.toml \\
                     --pairs replay/conveyor --iterations 1000000 --format json --out out/conveyor
  pickcell recognize --cell cell.toml --left l.png --right r.png --stages out/stages

Exit code: 0 done (also where nothing was found), 1 pairs of --pairs failed or the disk is full,
2 wrong usage, configuration, picture or place of a result.";

/// Recognise thin parts in one stereo pair, or in a folder of pairs
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct RecognizeArgs {
    /// Take calibration, parts, colours, search, limits and gripper from this cell; other options override it
    #[arg(long, value_name = "FILE")]
    pub cell: Option<PathBuf>,
    /// Calibration: OpenCV YAML, or one file of a ROS camera_info pair, or their folder
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    /// Part file; may be given several times
    #[arg(long = "part", value_name = "FILE")]
    pub parts: Vec<PathBuf>,

    /// Picture of the left camera, png or jpg
    #[arg(
        long,
        value_name = "FILE",
        requires = "right",
        conflicts_with = "pairs",
        help_heading = "Pictures"
    )]
    pub left: Option<PathBuf>,
    /// Picture of the right camera, png or jpg
    #[arg(long, value_name = "FILE", requires = "left", conflicts_with = "pairs", help_heading = "Pictures")]
    pub right: Option<PathBuf>,
    /// Recording (.mcap), or folder of pairs: every folder in it with left.png|jpg and right.png|jpg; or, where it
    /// has left/ and right/, the pictures of equal name in them
    #[arg(long, value_name = "DIR|MCAP", help_heading = "Pictures")]
    pub pairs: Option<PathBuf>,

    /// Find the threshold in every picture (the default)
    #[arg(long, value_enum, conflicts_with_all = ["color_min", "color_max", "grey_min", "grey_max"], help_heading = "Pixels")]
    pub color: Option<ColorChoice>,
    /// Least red, green and blue of a part's pixel [default: 0,0,0]
    #[arg(long, value_name = "R,G,B", allow_hyphen_values = true, value_parser = rgb, conflicts_with_all = ["grey_min", "grey_max"], help_heading = "Pixels")]
    pub color_min: Option<Rgb>,
    /// Greatest red, green and blue of a part's pixel [default: 255,255,255]
    #[arg(long, value_name = "R,G,B", allow_hyphen_values = true, value_parser = rgb, conflicts_with_all = ["grey_min", "grey_max"], help_heading = "Pixels")]
    pub color_max: Option<Rgb>,
    /// Least BT.601 luma of a part's pixel [default: 0]
    #[arg(long, value_name = "0..255", allow_hyphen_values = true, value_parser = whole::<u8>(0, 255), help_heading = "Pixels")]
    pub grey_min: Option<u8>,
    /// Greatest BT.601 luma of a part's pixel [default: 255]
    #[arg(long, value_name = "0..255", allow_hyphen_values = true, value_parser = whole::<u8>(0, 255), help_heading = "Pixels")]
    pub grey_max: Option<u8>,
    /// Dark parts on a light floor; with a range of colours: parts are the pixels outside of it
    #[arg(long, help_heading = "Pixels")]
    pub inverted: bool,
    /// Corners of the region where parts are looked for, in both pictures: 10,10 600,10 600,400
    #[arg(long, value_name = "X,Y", value_parser = corner, num_args = 3.., help_heading = "Pixels")]
    pub region_px: Option<Vec<[f32; 2]>>,
    /// Connected specks of fewer pixels are dropped [default: 20]
    #[arg(long, value_name = "PIXELS", allow_hyphen_values = true, value_parser = whole::<u32>(0, u32::MAX.into()), help_heading = "Pixels")]
    pub min_speck_px: Option<u32>,
    /// Thinning [default: zhang-suen]
    #[arg(long, value_enum, help_heading = "Pixels")]
    pub thin: Option<ThinChoice>,

    /// Search; auto is exhaustive where its tree is small enough, harmony beyond [default: auto]
    #[arg(long, value_enum, help_heading = "Search")]
    pub search: Option<SearchChoice>,
    /// Which right nodes may go with a left one [default: epipolar]
    #[arg(long, value_enum, help_heading = "Search")]
    pub gate: Option<GateChoice>,
    /// Time for a pair, in milliseconds, from the moment its pictures are read [default: 30]
    #[arg(long, value_name = "MS", allow_hyphen_values = true, value_parser = milliseconds, conflicts_with = "iterations", help_heading = "Search")]
    pub deadline_ms: Option<f64>,
    /// A count of search iterations in place of a deadline: the same result however fast the machine
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = whole::<u64>(1, u64::MAX), help_heading = "Search")]
    pub iterations: Option<u64>,
    /// Seed of all randomness [default: 1]
    #[arg(long, value_name = "N", allow_hyphen_values = true, value_parser = whole::<u64>(0, u64::MAX), help_heading = "Search")]
    pub seed: Option<u64>,
    /// Threads for the two pictures of a pair: with 2 they are worked on at the same time [default: 1]
    #[arg(long, value_name = "1|2", allow_hyphen_values = true, value_parser = whole::<u8>(1, 2), help_heading = "Search")]
    pub threads: Option<u8>,
    /// Recognise every pair so many times and give p50 and p99 of every stage
    #[arg(long, value_name = "N", default_value_t = 1, allow_hyphen_values = true, value_parser = whole::<u32>(1, 10_000_000), help_heading = "Search")]
    pub repeat: u32,

    /// Write both pictures with the result on top; with --pairs see --stages
    #[arg(long, value_name = "PNG", conflicts_with = "pairs", help_heading = "Output")]
    pub overlay: Option<PathBuf>,
    /// Write what each stage saw into this folder (with --pairs: into a folder of the name of each pair in it):
    /// {left,right}-{binary,skeleton,graph}.png and overlay.png. Where wire is 12 pixels thick or more, skeleton and graph are of
    /// the picture at half its size, or less; where Zhang and Suen leave object pixels far from any line, as of wire at 45
    /// degrees and of blobs, the skeleton has Guo and Hall's
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    pub stages: Option<PathBuf>,
    /// Write results.json for every pair into a folder of its name in this one; a pair of files left.png and right.png has
    /// the name of their folder
    #[arg(long, value_name = "DIR", help_heading = "Output")]
    pub out: Option<PathBuf>,
    /// How results are printed
    #[arg(long, value_enum, default_value_t = Format::Text, help_heading = "Output")]
    pub format: Format,
}

/// Has corners with a negative x taken for values of `--region-px`, not for options, and those after `--region-px=` for more of
/// its values: so they get to the check of the region, which says what is allowed.
pub fn corners_as_values(arguments: impl IntoIterator<Item = OsString>) -> Vec<OsString> {
    let (mut values, mut are_corners) = (Vec::new(), false);
    for argument in arguments {
        let text = argument.to_string_lossy();
        if let Some(first) = text.strip_prefix("--region-px=") {
            are_corners = true;
            values.extend(["--region-px".into(), format!(" {first}").into()]);
        } else if are_corners
            && text.strip_prefix('-').is_some_and(|x| x.starts_with(|c: char| c == '.' || c.is_ascii_digit()))
        {
            // No option begins with a blank; a corner may.
            values.push(format!(" {text}").into());
        } else {
            are_corners = text == "--region-px" || are_corners && !text.starts_with('-');
            values.push(argument);
        }
    }
    values
}

/// Red, green and blue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rgb(pub [u8; 3]);

/// `--color`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ColorChoice {
    /// A threshold found in every picture.
    Auto,
}

/// `--thin`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ThinChoice {
    /// Zhang and Suen, 1984
    ZhangSuen,
    /// Guo and Hall, 1989
    GuoHall,
}

/// `--search`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SearchChoice {
    /// Exhaustive where its tree is small enough, else harmony
    Auto,
    /// Harmony Search, the paper's algorithms 1 and 3
    Harmony,
    /// Improved Harmony Search, equations 2 to 4
    Improved,
    /// Self-adaptive Harmony Search, equations 5 and 6
    SelfAdaptive,
    /// Random search
    Random,
    /// Exact branch and bound
    Exhaustive,
}

/// `--gate`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum GateChoice {
    /// Only nodes that can be the same point
    Epipolar,
    /// All nodes
    None,
}

/// `--format`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// A small table for people
    Text,
    /// One JSON object a pair and line
    Json,
}

impl From<ThinChoice> for Algorithm {
    fn from(choice: ThinChoice) -> Self {
        match choice {
            ThinChoice::ZhangSuen => Algorithm::ZhangSuen,
            ThinChoice::GuoHall => Algorithm::GuoHall,
        }
    }
}

impl From<SearchChoice> for SearchMethod {
    fn from(choice: SearchChoice) -> Self {
        match choice {
            SearchChoice::Auto => SearchMethod::Auto,
            SearchChoice::Harmony => SearchMethod::Harmony,
            SearchChoice::Improved => SearchMethod::Improved,
            SearchChoice::SelfAdaptive => SearchMethod::SelfAdaptive,
            SearchChoice::Random => SearchMethod::Random,
            SearchChoice::Exhaustive => SearchMethod::Exhaustive,
        }
    }
}

impl From<GateChoice> for Gate {
    fn from(choice: GateChoice) -> Self {
        match choice {
            GateChoice::Epipolar => Gate::Epipolar,
            GateChoice::None => Gate::None,
        }
    }
}

fn rgb(text: &str) -> Result<Rgb, String> {
    let numbers: Option<Vec<u8>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    let colour: Option<[u8; 3]> = numbers.and_then(|n| n.try_into().ok());
    colour.map(Rgb).ok_or_else(|| "must be three whole numbers from 0 to 255, as 100,100,100".to_owned())
}

fn corner(text: &str) -> Result<[f32; 2], String> {
    let number = |n: &str| n.trim().parse().ok().filter(|v: &f32| v.is_finite());
    let numbers: Option<Vec<f32>> = text.split(',').map(number).collect();
    let corner: Option<[f32; 2]> = numbers.and_then(|n| n.try_into().ok());
    corner.ok_or_else(|| "must be two numbers, x,y in pixels".to_owned())
}

fn milliseconds(text: &str) -> Result<f64, String> {
    let allowed = |ms: &f64| ms.is_finite() && *ms > 0.0 && *ms <= 3_600_000.0;
    let ms: Option<f64> = text.parse().ok().filter(allowed);
    ms.ok_or_else(|| "must be a number of milliseconds above 0 and at most 3600000".to_owned())
}
