//! What can be wrong with parameters and pictures.

use super::SIZE_MAX;

/// Parameters that cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ParamsError {
    /// A range whose least value is above its greatest.
    #[error(
        "colour range is empty: {key} goes from {min} to {max}; give a minimum that is not above the maximum"
    )]
    EmptyRange {
        /// Which range, and for a box which channel.
        key: &'static str,
        /// Least value.
        min: u8,
        /// Greatest value.
        max: u8,
    },
    /// Too few corners.
    #[error("region_px has {corners} corner(s); give at least 3, or none for the whole picture")]
    RegionCorners {
        /// How many.
        corners: usize,
    },
    /// A corner that is no number or not in the picture.
    #[error(
        "region_px: corner {index} is ({x}, {y}), outside the {width}x{height} picture; x must be 0 to {width} and y 0 to {height}"
    )]
    RegionOutside {
        /// Which corner, from 0.
        index: usize,
        /// Its x.
        x: f32,
        /// Its y.
        y: f32,
        /// Picture width.
        width: usize,
        /// Picture height.
        height: usize,
    },
    /// Two sides cross.
    #[error(
        "region_px: the sides after corner {first} and after corner {second} cross; list the corners in order around the region"
    )]
    RegionCrosses {
        /// First corner of one side.
        first: usize,
        /// First corner of the other.
        second: usize,
    },
    /// No area.
    #[error(
        "region_px has no area ({corners} corners on a line or all at one place); give corners around the bin"
    )]
    RegionEmpty {
        /// How many corners.
        corners: usize,
    },
    /// A picture without pixels or too large.
    #[error("picture size {width}x{height}: width and height must be 1 to {max}", max = SIZE_MAX)]
    Size {
        /// Picture width.
        width: usize,
        /// Picture height.
        height: usize,
    },
}

/// A picture that cannot be binarized.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// Frame or bit image of another size than `new` was told.
    #[error(
        "picture is {width}x{height} where {wanted_width}x{wanted_height} was set up; set the camera's size or the calibration's"
    )]
    Size {
        /// The frame's or bit image's width.
        width: usize,
        /// The frame's or bit image's height.
        height: usize,
        /// Width of `new`.
        wanted_width: usize,
        /// Height of `new`.
        wanted_height: usize,
    },
    /// A JPEG: decode it first.
    #[error("picture is still MJPEG; decode it first")]
    Compressed,
    /// Fewer bytes than size, stride and format need.
    #[error("picture has {bytes} bytes where its size and format need {needed}; the frame was cut short")]
    Short {
        /// Bytes there.
        bytes: usize,
        /// Bytes needed.
        needed: usize,
    },
    /// More specks than are dropped: a picture of noise.
    #[error(
        "picture has more than {specks_max} specks: more light, less gain, or a narrower colour range (recognition.colour, --color-min) \
         or region (recognition.region_px, --region-px)"
    )]
    Specks {
        /// How many are.
        specks_max: u32,
    },
    /// A distance between rows that is less than a row.
    #[error("picture has rows of {stride_bytes} bytes, less than its {width} pixels need")]
    Stride {
        /// Bytes between rows.
        stride_bytes: usize,
        /// Picture width.
        width: usize,
    },
}
