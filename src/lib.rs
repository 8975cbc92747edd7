//! The driver of one robot cell: two webcams look into a bin of thin parts (rods, wires, hooks), the driver
//! recognises the parts under a deadline, and the arm gets one grasp target after another.
//!
//! ```text
//! camera ─ FramePair ─ BitImage ─ Skeleton ─ Graph ─ StereoMatch ─ PartPose ─ GraspTarget ─ arm
//!          pair        binarize   thin       graph   harmony       pose       grasp
//! ```
//!
//! # The stages
//!
//! "Paper" is "The Graph Matching Optimization Methodology for Thin Object Recognition in Pick and Place Tasks".
//! `docs/recognition.md` walks through the same stages with equations and figures of its text.
//!
//! | stage | takes | gives | paper | thread |
//! |---|---|---|---|---|
//! | [`camera`] | buffers of a V4L2 device, or pictures of a session | [`Frame`](frame::Frame) with the time of its light | V | left, right |
//! | [`cell::pairing`] | frames of both cameras | [`FramePair`](frame::FramePair) | V | arm |
//! | [`vision::decode`] | an MJPEG frame | a raw frame | | recognise |
//! | [`vision::luma`] | a raw frame | its luma, a byte a pixel: what is measured later is read there | | recognise |
//! | [`vision::binarize`](mod@vision::binarize) | a raw frame | [`BitImage`](vision::bits::BitImage), object = 1 | IV-A, Algorithm 2 | recognise |
//! | [`vision::halve`] | bit image and luma of thick wire | the same at half the size | | recognise |
//! | [`vision::thin`](mod@vision::thin) | the bit image | its skeleton, one pixel wide | IV-B | recognise |
//! | [`vision::graph`](mod@vision::graph) | skeleton, mask, grey values | [`Graph`](vision::graph::Graph): ends, junctions, pixel chains | IV-C | recognise |
//! | [`vision::hue`] | a raw frame, colours of parts and floor | grey values in which parts stand out by their colour | | recognise |
//! | [`matching`] | two graphs, the rig, a part's model | matches of nodes with their fitness | III, IV-D, equations (2) to (8) | recognise |
//! | [`pose`] | a rough pose, both pictures | the pose that agrees with both outlines, with its spread | V | recognise |
//! | [`grasp`] | the poses of all parts | ranked targets, or why a part is blocked | V | recognise |
//! | [`cell::core`] | events and their times | actions: what is searched, sent, said | IV-D (stop) | arm |
//! | [`arm`] over [`firmware_bridge`] | a target | bytes on a wire, and reports back | | arm |
//!
//! [`recognize`] composes the stages from pixels to grasps. A stage has one shape: `Params`, a workspace that owns all
//! its memory, `new`, `run`; each is usable as a library without a cell.toml. The threads, and a fifth for what is cold
//! (printing, drawing, writing), are those of [`cell::threads`], which carries letters between them and decides
//! nothing. With `recognition.threads = 2` a sixth takes the right picture of each pair through all stages up to the
//! graph, while the recognise thread takes the left one ([`hands`]).
//!
//! # The rooms
//!
//! Hot: the real-time path; after `new` it allocates nothing, takes no lock, writes no log. Pure: no clock, no device,
//! no thread: memory, time and randomness are arguments; how long each stage took is asked of [`time`], and decides nothing. Edge: touches a device. Cold: everything else.
//!
//! | room | owns | |
//! |---|---|---|
//! | [`commands`] | one file a command: parse, build, run, exit code | cold |
//! | [`config`] | cell.toml as written → checked [`Cell`](config::Cell) | cold |
//! | [`time`] | time stamps, [`Budget`](time::Budget); the only room that reads a clock | leaf |
//! | [`frame`] | pictures with format, stride, colour encoding and time stamp | leaf |
//! | [`handover`] | wakes a thread that sleeps | leaf |
//! | [`hands`] | one half of a job done by a second thread | leaf |
//! | [`level`] | the instruction sets that this machine has | leaf |
//! | [`rig`] | intrinsics, distortion, stereo geometry, calibration files | leaf |
//! | [`part`] | part models: nodes, edges, thickness, grasp, symmetries | leaf |
//! | [`camera`] | V4L2 cameras, recorded sessions as cameras | edge |
//! | [`vision`] | pixels → nodes and edges | hot, pure |
//! | [`matching`], [`pose`] | nodes → matches → poses | hot, pure |
//! | [`grasp`] | poses → targets | hot, pure |
//! | [`picture`] | the stages up to nodes in a row, for a picture | hot, pure |
//! | [`recognize`] | the stages in a row, for a pair | hot, pure |
//! | [`cell`] | every decision in `core`; the threads that carry events to it and actions from it | hot |
//! | [`arm`] | the links of firmware_bridge as one type | edge |
//! | [`telemetry`] | histograms and counters, written hot, read cold | hot |
//! | [`session`] | recordings: MCAP reader, writer and copier; folders of pictures | cold |
//! | [`accuracy`] | recognition against known truth | cold |
//! | [`report`] | overlay and stage pictures | cold |
//! | [`files`] | files written whole or not at all | cold |
//!
//! # In another program
//!
//! `pickcell = { path = "…" }` in its Cargo.toml is all; signatures speak of [`nalgebra`] and [`rand_pcg`], which are here under these
//! names in the version that fits. [`recognize::Recognizer`] is the whole way from a pair of frames to grasps; each stage has an example
//! of its own. Examples read files of this repository, for which `CARGO_MANIFEST_DIR` stands; elsewhere give your own.
//!
//! # Frames and units
//!
//! Lengths are millimetres (`_mm`), angles degrees in files (`_deg`) and radians inside, durations `_ms`, `_us`, `_ns`.
//! Camera frames are OpenCV's (x right, y down, z forward); the base is the robot's, z up. Transforms are named by
//! their frames: `base_from_left`. Pixels are the camera's own, distorted, with pixel centres at whole numbers.

pub use {nalgebra, rand_pcg};

pub mod accuracy;
pub mod arm;
pub mod camera;
pub mod cell;
pub mod commands;
pub mod config;
pub mod files;
pub mod frame;
pub mod grasp;
pub mod handover;
pub mod hands;
pub mod level;
pub mod matching;
pub mod part;
pub mod picture;
pub mod pose;
pub mod recognize;
pub mod report;
pub mod rig;
pub mod session;
pub mod telemetry;
pub mod time;
pub mod vision;
