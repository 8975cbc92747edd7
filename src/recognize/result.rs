//! What recognition gives: the parts of a pair, why nothing can be taken, or why the pair was refused.

use arrayvec::ArrayVec;
use nalgebra::{Isometry3, Point3, Vector2, Vector3};

use crate::grasp::{Blocked, Grasp};
use crate::part::NODES_MAX;
use crate::rig::Rig;
use crate::time::Spent;
use crate::vision::{binarize, graph};

/// Most parts of a pair.
pub(super) const PARTS_MAX: usize = 128;

/// Why a pair was not recognised at all.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// A picture's size is not the calibration's.
    #[error(
        "{side} picture is {width}x{height}, the calibration is for {rig_width}x{rig_height}: set the camera's size or calibrate again"
    )]
    Size {
        /// `left` or `right`.
        side: Side,
        /// Picture width.
        width: usize,
        /// Picture height.
        height: usize,
        /// The calibration's.
        rig_width: usize,
        /// The calibration's.
        rig_height: usize,
    },
    /// Both pictures are the same, byte by byte, and not empty: what is seen in them has no depth.
    #[error("the left and the right picture are the same: give each camera its own path")]
    Same,
    /// Ends of wire lie where they would if each picture were the other camera's.
    #[error("the left and the right picture are exchanged: give each camera the other's path")]
    Exchanged,
    /// A compressed picture that cannot be decoded.
    #[error("{side} picture cannot be decoded: damaged, cut short or of another size")]
    Damaged {
        /// `left` or `right`.
        side: Side,
    },
    /// The frame's bytes are not those of its format and size.
    #[error("{side} picture: {reason}")]
    Binarize {
        /// `left` or `right`.
        side: Side,
        /// Why.
        reason: binarize::Refusal,
    },
    /// The picture is white all over, so that no threshold can be found: not an empty bin, a blinded camera.
    #[error(
        "{side} picture is white all over: less light, a shorter exposure, or a colour range in place of auto (recognition.colour, --color-min)"
    )]
    White {
        /// `left` or `right`.
        side: Side,
    },
    /// The picture is black all over: not an empty bin, a camera that sees no light.
    #[error(
        "{side} picture is black all over, or nearly so: look at the light, the cap of the lens and the exposure"
    )]
    Black {
        /// `left` or `right`.
        side: Side,
    },
    /// The picture is noise all over: not an empty bin, a camera that sees next to no light and amplifies it.
    #[error(
        "{side} picture is noise and nothing else: look at the light, the cap of the lens, the gain and the exposure"
    )]
    Noise {
        /// `left` or `right`.
        side: Side,
    },
    /// Every pixel is as light as every other, which no camera sees: it gives no picture.
    #[error("{side} picture is the same all over: look at the camera's cable and whether it gives a picture")]
    Flat {
        /// `left` or `right`.
        side: Side,
    },
    /// The picture shows too much.
    #[error("{side} picture: {reason}")]
    Graph {
        /// `left` or `right`.
        side: Side,
        /// Why.
        reason: graph::Refusal,
    },
}

/// One of the two cameras.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Side {
    /// The left one.
    Left,
    /// The right one.
    Right,
}

impl std::fmt::Display for Side {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str(if *self == Side::Left { "left" } else { "right" })
    }
}

/// Why a pair gives no pick.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum NoPick {
    /// Nothing but floor.
    #[error("bin empty")]
    BinEmpty,
    /// Something lies there, but no part was recognised.
    #[error("nothing recognised")]
    NothingRecognised,
    /// Parts were recognised, none can be taken.
    #[error("all blocked")]
    AllBlocked,
    /// The budget, in time or in iterations, was spent before all was searched and looked at, and nothing that was found
    /// by then can be taken.
    #[error("search cut short")]
    OutOfTime,
}

/// Which pictures show a node of a part.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Seen {
    /// Both.
    Both,
    /// Only the left one.
    Left,
    /// Only the right one.
    Right,
    /// None: its place follows from the fitted model.
    None,
}

/// A node of a recognised part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FoundNode {
    /// Place in the left camera's frame.
    pub left_mm: Point3<f64>,
    /// Its projection into the left picture (distorted pixels).
    pub left_px: Vector2<f64>,
    /// Its projection into the right picture.
    pub right_px: Vector2<f64>,
    /// Where an image node was found for it.
    pub seen: Seen,
}

/// A recognised part.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundPart {
    /// Index of the part.
    pub part: usize,
    /// Fitness of the fitted part, in the terms and weights of a match, see [`crate::matching::fitness`].
    pub fitness: f64,
    /// From the part's frame to the left camera's.
    pub left_from_part: Isometry3<f64>,
    /// Its nodes, in the part file's order.
    pub nodes: ArrayVec<FoundNode, NODES_MAX>,
    /// How to take it.
    pub grasp: Grasp,
    /// Standard deviation of the grasp's position along the axes of its frame, mm.
    pub sigma_mm: Vector3<f64>,
    /// Root mean square angle between the wire's direction at the grasp and the true one, radians.
    pub sigma_axis_rad: f64,
    /// Why it cannot be taken.
    pub blocked: Option<Blocked>,
    /// Iterations of the searches of its pair.
    pub iterations: u64,
    /// Whether nothing speaks against it, see [`crate::matching::select::is_sound`].
    pub sound: bool,
    /// Whether its pose is proved, see [`crate::matching::select::is_proven`]; if not it is not offered.
    pub proven: bool,
    /// Share of its length that is seen with both outlines, the lesser of both pictures.
    pub clear: f64,
}

/// Wall time of each stage in nanoseconds: the sum of both pictures, or the longer one where two threads share them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StageTimes {
    /// Decompression.
    pub decode_ns: u64,
    /// Pixels to bits.
    pub binarize_ns: u64,
    /// Bits to skeletons.
    pub thin_ns: u64,
    /// Skeletons to graphs and nodes.
    pub graph_ns: u64,
    /// Search.
    pub match_ns: u64,
    /// Refinement, competition and grasps.
    pub pose_ns: u64,
    /// All of it.
    pub total_ns: u64,
}

impl StageTimes {
    /// Puts the stages of the right picture with those of the left.
    pub(super) fn with(&mut self, right: &Self, together: impl Fn(u64, u64) -> u64) {
        self.decode_ns = together(self.decode_ns, right.decode_ns);
        self.binarize_ns = together(self.binarize_ns, right.binarize_ns);
        self.thin_ns = together(self.thin_ns, right.thin_ns);
        self.graph_ns = together(self.graph_ns, right.graph_ns);
    }
}

impl std::fmt::Display for Turned {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let Self { rows_px, rim_px, doubt, .. } = self;
        if *doubt == Some(Doubt::EndsApart) {
            return write!(f, "the cameras do not stand as they were calibrated");
        }
        write!(
            f,
            "the right camera has turned since it was calibrated: {rows_px:+.2} px across the baseline, "
        )?;
        write!(f, "{rim_px:+.2} px at the rim")
    }
}

impl Turned {
    /// Whether the poses allow for anything.
    pub fn is_allowed_for(&self) -> bool {
        self.allowed_for != Vector3::zeros()
    }
}

impl Recognition {
    /// The rig as the poses have it: calibrated so, and the right camera turned as is allowed for.
    pub fn rig(&self, calibrated: &Rig) -> Rig {
        match self.turned {
            Some(turned) if turned.is_allowed_for() => calibrated.with_right_turned(&turned.allowed_for),
            _ => *calibrated,
        }
    }

    /// Nothing yet, with memory for as many parts as a pair can give.
    pub fn with_room() -> Self {
        Self { parts: Vec::with_capacity(PARTS_MAX), ..Self::default() }
    }
}

/// How far the right camera has turned since the rig was calibrated, as all parts of a pair together tell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Turned {
    /// About the baseline: how far what the middle of the right picture shows is displaced across the baseline, pixels;
    /// positive is lower in the picture, where the right camera stands to the right.
    pub rows_px: f64,
    /// Its standard deviation.
    pub rows_sigma_px: f64,
    /// About its line of sight: how far what the rim of the right picture shows, half its width from the middle, is
    /// displaced, pixels; positive where the camera has turned clockwise, seen from behind it.
    pub rim_px: f64,
    /// Its standard deviation.
    pub rim_sigma_px: f64,
    /// About what is upright upon the baseline: how far what the right picture shows is displaced along the baseline, pixels;
    /// positive where that makes things look farther away, and so larger. It is not allowed for: parts that are longer than
    /// their files say look the same.
    pub along_px: f64,
    /// Its standard deviation, were the part files exact.
    pub along_sigma_px: f64,
    /// What the poses allow for, the certain part of it: a rotation vector, radians, along the left camera's axes; nought
    /// where that is nothing.
    pub allowed_for: Vector3<f64>,
    /// Why nothing is offered.
    pub doubt: Option<Doubt>,
}

/// Why it is in doubt how the cameras stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Doubt {
    /// Hardly any end of wire in one picture lies on the epipolar line of an end like it in the other.
    #[error("hardly an end of wire lies where the other picture says it should: no part is offered")]
    EndsApart,
    /// More of a turn is certain than is allowed for.
    #[error("not all of it can be allowed for: no part is offered")]
    Rest,
    /// A camera that has been knocked so far has turned along the baseline as well, which only lengths tell.
    #[error("so far that heights may be wrong too: no part is offered")]
    Far,
}

/// What a pair shows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recognition {
    /// The parts, those that can be taken first, best first.
    pub parts: Vec<FoundPart>,
    /// Why nothing can be taken; `None` where something can.
    pub no_pick: Option<NoPick>,
    /// Nodes of the left picture's graph.
    pub nodes_left: usize,
    /// Nodes of the right picture's graph.
    pub nodes_right: usize,
    /// The random seed that was used.
    pub seed: u64,
    /// What of the budget was used up.
    pub spent: Spent,
    /// Whether the search was cut short: its budget was spent, or there was more than it has room for.
    pub out_of_time: bool,
    /// What the parts, or ends of wire, tell of the calibration; `None` where nothing does.
    pub turned: Option<Turned>,
    /// How long each stage took.
    pub stages: StageTimes,
}
