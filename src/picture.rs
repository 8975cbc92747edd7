//! One picture through the stages of vision: decoded, binarized, halved where its wire is thick, thinned, read as a graph.

mod blind;

use blind::blind;

use crate::frame::{Frame, PixelFormat, RgbView};
use crate::matching::nodes::{ImageNode, ImageNodes};
use crate::part::Part;
use crate::recognize::{Params, Refusal, Side, StageTimes};
use crate::rig::{CameraModel, UndistortTable};
use crate::time::Timestamp;
use crate::vision::beside::Beside;
use crate::vision::binarize::{self, Binarize, ColourRange};
use crate::vision::bits::BitImage;
use crate::vision::decode::{DecodeError, Decoder, Output};
use crate::vision::graph::{self, Graph, Graphs};
use crate::vision::halve::{halve_luma, halve_mask, thickness_px};
use crate::vision::hue::{Colours, HuePlane};
use crate::vision::luma::LumaPlane;
use crate::vision::thin::whole::WholeThin;

/// How far off the rays of nodes may be, in pixels: a twentieth of what a good node is.
const RAY_ERROR_PX: f64 = 0.005;
/// Wire at least so thick is looked at in a picture of half the size, unless the thinnest part may be thinner than the
/// second of these.
const THICK_PX_MIN: f64 = 12.0;
const THIN_PX_MIN: f64 = 8.0;
/// Where wire turns out to be thinner than this in a half, what was thick was something else: the whole is looked at.
const HALVED_PX_MIN: f64 = 4.5;
/// Wire is taken to be no wider than this.
const HALF_WIDTH_PX_MAX: f32 = 40.0;
/// No picture is made smaller than this on its shorter side.
const SIDE_PX_MIN: usize = 200;

/// The stages of one camera and what they made of its last picture.
pub struct Picture {
    decoder: Decoder,
    luma: LumaPlane,
    /// Where a range of colours is given.
    hue: Option<HuePlane>,
    /// Whether grey values are those of its plane.
    in_hue: bool,
    binarize: Binarize,
    /// The picture as it is, and halved once, twice and so on.
    sizes: Vec<Traced>,
    /// Which of them the last one was traced in.
    halvings: usize,
    /// Thickness of the thinnest over that of the thickest part.
    evenness: f64,
}

/// A picture in one size, from its mask on.
struct Traced {
    rays: UndistortTable,
    thin: WholeThin,
    graphs: Graphs,
    image_nodes: ImageNodes,
    /// Its luma; empty where it is not halved.
    plane: Frame,
    mask: BitImage,
    skeleton: BitImage,
    graph: Graph,
    /// Half thickness of each edge and its weight, thinnest first.
    widths: Vec<(f32, usize)>,
    half_width_px: f64,
}

impl Traced {
    fn new(params: &Params, camera: CameraModel, plane: Frame) -> Self {
        let (width, height) = (camera.width, camera.height);
        let graph_limits = params.graph.unwrap_or(graph::Params::for_size(width, height));
        let mut graph = Graph::default();
        graph.reserve(&graph_limits);
        Self {
            thin: WholeThin::new(params.thin, width, height),
            graphs: Graphs::new(graph_limits, width, height),
            image_nodes: ImageNodes::new(params.nodes),
            plane,
            mask: BitImage::new(width, height),
            skeleton: BitImage::new(width, height),
            graph,
            rays: UndistortTable::new(&camera, RAY_ERROR_PX),
            widths: Vec::with_capacity(graph_limits.edges_max as usize),
            half_width_px: 0.0,
        }
    }

    /// From mask and luma to nodes; says whether there was time for all.
    fn run(
        &mut self,
        luma: Option<&Frame>,
        end: Option<Timestamp>,
        stages: &mut StageTimes,
    ) -> Result<bool, graph::Refusal> {
        let Self { mask, skeleton, graph, .. } = self;
        let begin = Timestamp::now();
        self.thin.run(mask, skeleton);
        let thinned = Timestamp::now();
        let in_time = !end.is_some_and(Timestamp::is_past)
            && self.graphs.run_until(skeleton, mask, luma.or(Some(&self.plane)), graph, end)?
            && self.image_nodes.run(graph, mask, &self.rays, end)?;
        self.half_width_px = half_width_px(graph, &mut self.widths);
        stages.thin_ns += thinned.ns_since(begin);
        stages.graph_ns += Timestamp::now().ns_since(thinned);
        Ok(in_time)
    }

    /// Has nothing of the last picture any more, but for pixels.
    fn clear(&mut self) {
        self.graph.clear();
        self.image_nodes.clear();
    }
}

/// Half the width of a picture's wire in pixels: what a quarter of it does not exceed, for regions of several wires are wider. Edges
/// count by the squares of their lengths: short ones are the grain of a dark wall.
fn half_width_px(graph: &Graph, widths: &mut Vec<(f32, usize)>) -> f64 {
    widths.clear();
    widths.extend(graph.edges.iter().map(|e| (e.half_thickness_px, e.points.len().pow(2))));
    widths.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let all: usize = widths.iter().map(|(_, weight)| weight).sum();
    let mut below = 0;
    let quarter = widths.iter().find(|(_, weight)| {
        below += weight;
        4 * below >= all
    });
    f64::from(quarter.map_or(HALF_WIDTH_PX_MAX, |(half, _)| half.min(HALF_WIDTH_PX_MAX)))
}

impl Picture {
    pub(crate) fn new(
        range: binarize::Params,
        params: &Params,
        camera: CameraModel,
        parts: &[Part],
    ) -> Result<Self, binarize::ParamsError> {
        let (width, height) = (camera.width, camera.height);
        let mut sizes = vec![Traced::new(params, camera, Frame::default())];
        sizes.extend(halvings(camera).skip(1).map(|half| {
            let (width, height) = (half.width, half.height);
            Traced::new(params, half, Frame::from_grey(width, height, vec![0; width * height]))
        }));
        let thickness = || parts.iter().map(|part| part.thickness_mm);
        let (thinnest, thickest) =
            (thickness().fold(f64::INFINITY, f64::min), thickness().fold(0.0, f64::max));
        let in_rgb = matches!(range.colour, ColourRange::Rgb { .. });
        let binarize = Binarize::new(range, width, height)?;
        let output = if binarize.needs_luma_only() { Output::Grey } else { Output::Rgb };
        Ok(Self {
            decoder: Decoder::new(output, width, height),
            hue: in_rgb.then(|| HuePlane::new(width, height)),
            in_hue: false,
            luma: LumaPlane::new(width, height),
            binarize,
            sizes,
            halvings: 0,
            evenness: if parts.is_empty() { 1.0 } else { thinnest / thickest },
        })
    }

    /// Takes a frame through all stages, in the size that its wire wants; says whether they were done by `end`. Between them,
    /// and in the long ones, it is asked how late it is.
    pub(crate) fn run(
        &mut self,
        frame: &Frame,
        side: Side,
        end: Option<Timestamp>,
        stages: &mut StageTimes,
    ) -> Result<bool, Refusal> {
        let (width, height) = (frame.width, frame.height);
        let [rig_width, rig_height] = [self.sizes[0].mask.width(), self.sizes[0].mask.height()];
        self.sizes.iter_mut().for_each(Traced::clear);
        self.in_hue = false;
        if (width, height) != (rig_width, rig_height) {
            return Err(Refusal::Size { side, width, height, rig_width, rig_height });
        }
        let begin = Timestamp::now();
        if end.is_some_and(|end| begin >= end) {
            return Ok(false);
        }
        let raw = self.decoder.run_until(frame, end).map(|_| ());
        let decoded = Timestamp::now();
        stages.decode_ns += decoded.ns_since(begin);
        match raw {
            Err(DecodeError::OutOfTime) => return Ok(false),
            raw => raw.map_err(|_| Refusal::Damaged { side })?,
        }
        let in_time = self.binarize(frame, side, end);
        stages.binarize_ns += Timestamp::now().ns_since(decoded);
        if !in_time? {
            return Ok(false);
        }
        let mut traced = self.trace(self.halvings, frame, side, end, stages);
        let refused = traced.err();
        // Grain makes the mean of the mask less, and may be more than a graph has room for.
        while traced.map_or(true, |in_time| in_time && self.is_thick(2.0 * self.half_width_px()))
            && self.halve(frame)
        {
            traced = self.trace(self.halvings, frame, side, end, stages);
        }
        while traced == Ok(true) && self.halvings > 0 && 2.0 * self.half_width_px() < HALVED_PX_MIN {
            traced = self.trace(self.halvings - 1, frame, side, end, stages);
        }
        traced.map_err(|last| refused.unwrap_or(last))
    }

    /// From the decoded `frame` to its mask, halved as often as its wire wants; says whether there was time.
    fn binarize(&mut self, frame: &Frame, side: Side, end: Option<Timestamp>) -> Result<bool, Refusal> {
        let Self { decoder, luma, binarize, sizes, .. } = self;
        let is_late = || end.is_some_and(Timestamp::is_past);
        let raw = raw_of(decoder, frame);
        let refused = |reason| Refusal::Binarize { side, reason };
        binarize.check(raw).map_err(refused)?;
        let has_luma = raw.format == PixelFormat::Grey || luma.run_until(raw, binarize.encoding(raw), end);
        if !has_luma || is_late() {
            return Ok(false);
        }
        let luma = luma_of(decoder, luma, frame);
        let seen = if binarize.needs_luma_only() { luma } else { raw };
        binarize.run(seen, &mut sizes[0].mask).map_err(refused)?;
        if is_late() {
            return Ok(false);
        }
        let range = binarize.params();
        let is_bright_on_dark = !range.inverted && range.colour == ColourRange::Auto;
        if let Some(refusal) = blind(luma, &sizes[0].mask, is_bright_on_dark, side) {
            return Err(refusal);
        }
        self.halvings = 0;
        while self.is_thick(thickness_px(self.mask())) && self.halve(frame) {}
        Ok(!is_late())
    }

    /// Whether wire so thick is better looked at in half the size: where it is thick, skeletons stray far where wires meet.
    fn is_thick(&self, thickness_px: f64) -> bool {
        thickness_px >= THICK_PX_MIN && thickness_px * self.evenness >= THIN_PX_MIN
    }

    /// Halves mask and luma of the decoded `frame` once more, which then are the picture; says whether they can be.
    fn halve(&mut self, frame: &Frame) -> bool {
        let Self { decoder, luma, sizes, halvings, .. } = self;
        let [whole, half, ..] = &mut sizes[*halvings..] else { return false };
        halve_mask(&whole.mask, &mut half.mask);
        let luma = if *halvings == 0 { luma_of(decoder, luma, frame) } else { &whole.plane };
        halve_luma(luma, &mut half.plane);
        *halvings += 1;
        true
    }

    /// Thins the picture halved so many times, and reads its graph; says whether there was time.
    fn trace(
        &mut self,
        halvings: usize,
        frame: &Frame,
        side: Side,
        end: Option<Timestamp>,
        stages: &mut StageTimes,
    ) -> Result<bool, Refusal> {
        self.halvings = halvings;
        let Self { decoder, luma, sizes, .. } = self;
        let luma = (halvings == 0).then(|| luma_of(decoder, luma, frame));
        sizes[halvings].run(luma, end, stages).map_err(|reason| Refusal::Graph { side, reason })
    }

    /// Has both pictures of a pair, which have just been run, in one size, the larger of theirs if a graph has room for it; says
    /// whether there was time.
    ///
    /// # Errors
    /// Where there is too much for a graph in the smaller size as well.
    pub(crate) fn agree(
        pictures: &mut [Picture; 2],
        frames: [&Frame; 2],
        end: Option<Timestamp>,
        stages: &mut StageTimes,
    ) -> Result<bool, Refusal> {
        let [left, right] = pictures.each_ref().map(Self::halvings);
        let mut all_halved = |halvings: usize| {
            let mut in_time = true;
            for ((picture, frame), side) in pictures.iter_mut().zip(frames).zip([Side::Left, Side::Right]) {
                if picture.halvings == halvings {
                    continue;
                }
                while picture.halvings < halvings && picture.halve(frame) {}
                in_time &= picture.trace(halvings, frame, side, end, stages)?;
            }
            Ok(in_time)
        };
        all_halved(left.min(right)).or_else(|_| all_halved(left.max(right)))
    }

    /// The colours of parts and floor at these places, in pixels of the size that was looked at; `None` where grey values stand for
    /// colours already, or no range of colours is given.
    pub(crate) fn colours(&self, frame: &Frame, places: &[Beside]) -> Option<Colours> {
        let Self { hue, in_hue, decoder, binarize, halvings, .. } = self;
        if hue.is_none() || *in_hue {
            return None;
        }
        let raw = raw_of(decoder, frame);
        Colours::at(places, &RgbView::with_encoding(raw, binarize.encoding(raw))?, *halvings)
    }

    /// Works out the grey values in which these colours stand out; says whether there was time.
    pub(crate) fn write_hue(&mut self, frame: &Frame, colours: &Colours, end: Option<Timestamp>) -> bool {
        let Self { hue: Some(hue), decoder, binarize, .. } = self else { return false };
        let raw = raw_of(decoder, frame);
        hue.run_until(raw, binarize.encoding(raw), colours, end)
    }

    /// Has what was worked out stand for grey values from here on.
    pub(crate) fn look_in_hue(&mut self) {
        let Self { hue: Some(hue), in_hue, sizes, halvings, .. } = self else { return };
        *in_hue = true;
        for times in 1..=*halvings {
            let (larger, smaller) = sizes.split_at_mut(times);
            let whole = if times == 1 { hue.plane() } else { &larger[times - 1].plane };
            halve_luma(whole, &mut smaller[0].plane);
        }
    }

    /// Which pixels are object.
    pub(crate) fn range(&self) -> &binarize::Params {
        self.binarize.params()
    }

    /// Has nothing of its picture any more, which was broken off.
    pub(crate) fn forget(&mut self) {
        for Traced { mask, skeleton, .. } in &mut self.sizes {
            mask.clear();
            skeleton.clear();
        }
        self.sizes.iter_mut().for_each(Traced::clear);
    }

    /// Half the width of its wire, in pixels of the size that was looked at; at most 40.
    pub(crate) fn half_width_px(&self) -> f64 {
        self.traced().half_width_px
    }

    /// How often the picture was halved before it was thinned: what follows is in pixels of that size.
    pub fn halvings(&self) -> usize {
        self.halvings
    }

    /// The binary picture in its full size, without specks.
    pub fn whole_mask(&self) -> &BitImage {
        &self.sizes[0].mask
    }

    fn traced(&self) -> &Traced {
        &self.sizes[self.halvings]
    }

    /// The binary picture, without specks.
    pub fn mask(&self) -> &BitImage {
        &self.traced().mask
    }

    /// The skeleton of the mask, before spurs are cut.
    pub fn skeleton(&self) -> &BitImage {
        &self.traced().skeleton
    }

    /// Nodes and edges.
    pub fn graph(&self) -> &Graph {
        &self.traced().graph
    }

    /// Nodes with the bends of edges among them.
    pub fn nodes(&self) -> &[ImageNode] {
        self.traced().image_nodes.nodes()
    }

    /// The luma of `frame`, which must be the one of the last run, or what stands for it.
    pub(crate) fn luma<'a>(&'a self, frame: &'a Frame) -> &'a Frame {
        match (self.halvings, &self.hue) {
            (0, Some(hue)) if self.in_hue => hue.plane(),
            (0, _) => luma_of(&self.decoder, &self.luma, frame),
            _ => &self.traced().plane,
        }
    }
}

/// What `frame`, which was decoded last, is when it is decoded.
fn raw_of<'a>(decoder: &'a Decoder, frame: &'a Frame) -> &'a Frame {
    if frame.format == PixelFormat::Mjpeg { decoder.raw() } else { frame }
}

/// The luma of `frame`, which was taken through these stages.
fn luma_of<'a>(decoder: &'a Decoder, luma: &'a LumaPlane, frame: &'a Frame) -> &'a Frame {
    let raw = raw_of(decoder, frame);
    if raw.format == PixelFormat::Grey { raw } else { luma.plane() }
}

/// The camera of the picture as it is, and halved once, twice and so on, as long as that may be of use.
pub(crate) fn halvings(camera: CameraModel) -> impl Iterator<Item = CameraModel> {
    std::iter::successors(Some(camera), |camera| {
        (camera.width.min(camera.height) / 2 >= SIDE_PX_MIN).then(|| camera.halved())
    })
}
