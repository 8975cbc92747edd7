//! What can be wrong with a calibration.

use std::io;
use std::path::PathBuf;

/// A calibration that cannot be used: names file, key, value and what to do.
#[derive(Debug, thiserror::Error)]
pub enum RigError {
    /// The file cannot be read.
    #[error("calibration {path}: {source}; give an OpenCV FileStorage YAML file, or one of a pair of ROS camera_info files, or the folder that holds the pair", path = .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The file cannot be written.
    #[error("calibration {path}: cannot be written: {source}", path = .path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The text is not the YAML that OpenCV or ROS write.
    #[error("calibration {path}, line {line}: {problem}; the file is truncated or is not a calibration: write it again", path = .path.display())]
    Syntax {
        /// The file.
        path: PathBuf,
        /// Counted from 1.
        line: usize,
        /// What was found there.
        problem: String,
    },
    /// A key that must be there is not.
    #[error("calibration {path}: {key} is missing; {remedy}", path = .path.display())]
    Missing {
        /// The file.
        path: PathBuf,
        /// The key.
        key: String,
        /// What it would be, and what is there.
        remedy: String,
    },
    /// Another format.
    #[error("calibration {path}: is {format}; write it as YAML: OpenCV's FileStorage does so where the name ends in .yml", path = .path.display())]
    Foreign {
        /// The file.
        path: PathBuf,
        /// `XML` or `JSON`.
        format: &'static str,
    },
    /// A key has a value that cannot be.
    #[error("calibration {path}: {key} = {value}: {problem}", path = .path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// The key.
        key: String,
        /// The value, or the offending part of it.
        value: String,
        /// What is wrong and what is allowed.
        problem: String,
    },
    /// Only one file of a ROS pair can be found.
    #[error("calibration {path}: the {wanted} camera's file is not beside it; name the two files left_camera_info.yaml and right_camera_info.yaml and put them into one folder", path = .path.display())]
    Pair {
        /// The file or folder that was given.
        path: PathBuf,
        /// The camera whose file was not found.
        wanted: &'static str,
    },
    /// A folder holds more than one ROS pair.
    #[error("calibration {path}: {count} pairs of camera_info files are in it; name a file of the one that is meant", path = .path.display())]
    Pairs {
        /// The folder.
        path: PathBuf,
        /// How many there are.
        count: usize,
    },
    /// Two cameras of different picture sizes do not fit into the one `image_width image_height` of the file.
    #[error("calibration {path}: the left camera has {left:?} pixels, the right one {right:?}; the OpenCV file has one image_width and image_height for both", path = .path.display())]
    TwoSizes {
        /// The file.
        path: PathBuf,
        /// Left width and height.
        left: (usize, usize),
        /// Right width and height.
        right: (usize, usize),
    },
    /// Pictures of another size than the calibration's.
    #[error("the {camera} picture is {}x{} pixels, the calibration was made for {}x{}; take pictures of that size, or calibrate at the pictures' size", .picture.0, .picture.1, .calibrated.0, .calibrated.1)]
    Size {
        /// `left` or `right`.
        camera: &'static str,
        /// Width and height of the calibration.
        calibrated: (usize, usize),
        /// Width and height of the picture.
        picture: (usize, usize),
    },
}
