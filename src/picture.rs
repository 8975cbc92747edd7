//! One picture through the stages of vision: decoded, binarized, thinned, read as a graph.

use crate::frame::{Frame, LumaView, PixelFormat};
use crate::matching::nodes::{ImageNode, ImageNodes};
use crate::recognize::{Params, Refusal, Side, StageTimes};
use crate::rig::{CameraModel, UndistortTable};
use crate::time::Timestamp;
use crate::vision::binarize::{self, Binarize, ColourRange};
use crate::vision::bits::BitImage;
use crate::vision::decode::{Decoder, Output};
use crate::vision::graph::{self, Graph, Graphs};
use crate::vision::luma::LumaPlane;
use crate::vision::thin::whole::WholeThin;

/// How far off the rays of nodes may be, in pixels: a twentieth of what a good node is.
const RAY_ERROR_PX: f64 = 0.005;

/// The stages of one camera and what they made of its last picture.
pub struct Picture {
    rays: UndistortTable,
    decoder: Decoder,
    luma: LumaPlane,
    binarize: Binarize,
    thin: WholeThin,
    graphs: Graphs,
    image_nodes: ImageNodes,
    mask: BitImage,
    skeleton: BitImage,
    graph: Graph,
}

impl Picture {
    pub(crate) fn new(
        range: binarize::Params,
        params: &Params,
        camera: CameraModel,
    ) -> Result<Self, binarize::ParamsError> {
        let (width, height) = (camera.width, camera.height);
        let binarize = Binarize::new(range, width, height)?;
        let graph_limits = params.graph.unwrap_or(graph::Params::for_size(width, height));
        let mut graph = Graph::default();
        graph.reserve(&graph_limits);
        let output = if binarize.needs_luma_only() { Output::Grey } else { Output::Rgb };
        Ok(Self {
            decoder: Decoder::new(output, width, height),
            luma: LumaPlane::new(width, height),
            binarize,
            thin: WholeThin::new(params.thin, width, height),
            graphs: Graphs::new(graph_limits, width, height),
            image_nodes: ImageNodes::new(params.nodes),
            mask: BitImage::new(width, height),
            skeleton: BitImage::new(width, height),
            graph,
            rays: UndistortTable::new(&camera, RAY_ERROR_PX),
        })
    }

    pub(crate) fn run(&mut self, frame: &Frame, side: Side, stages: &mut StageTimes) -> Result<(), Refusal> {
        let camera = self.rays.camera();
        if (frame.width, frame.height) != (camera.width, camera.height) {
            let (width, height) = (frame.width, frame.height);
            let (rig_width, rig_height) = (camera.width, camera.height);
            return Err(Refusal::Size { side, width, height, rig_width, rig_height });
        }
        let begin = Timestamp::now();
        let raw = self.decoder.run(frame).map_err(|_| Refusal::Damaged { side })?;
        let decoded = Timestamp::now();
        let refused = |reason| Refusal::Binarize { side, reason };
        self.binarize.check(raw).map_err(refused)?;
        let luma = match raw.format {
            PixelFormat::Grey => raw,
            _ => self.luma.run(raw, self.binarize.encoding(raw)),
        };
        let seen = if self.binarize.needs_luma_only() { luma } else { raw };
        self.binarize.run(seen, &mut self.mask).map_err(refused)?;
        let range = self.binarize.params();
        let is_light_on_dark = !range.inverted && range.colour == ColourRange::Auto;
        if is_light_on_dark && self.mask.words().iter().all(|&word| word == 0) && is_white(luma) {
            return Err(Refusal::White { side });
        }
        let binary = Timestamp::now();
        self.thin.run(&self.mask, &mut self.skeleton);
        let thinned = Timestamp::now();
        self.graphs
            .run(&self.skeleton, &self.mask, Some(luma), &mut self.graph)
            .map_err(|reason| Refusal::Graph { side, reason })?;
        self.image_nodes.run(&self.graph, &self.mask, &self.rays);
        let done = Timestamp::now();
        let ns = |from: Timestamp, to: Timestamp| to.since(from).max(0) as u64;
        stages.decode_ns += ns(begin, decoded);
        stages.binarize_ns += ns(decoded, binary);
        stages.thin_ns += ns(binary, thinned);
        stages.graph_ns += ns(thinned, done);
        Ok(())
    }

    /// The binary picture, without specks.
    pub fn mask(&self) -> &BitImage {
        &self.mask
    }

    /// The skeleton of the mask, before spurs are cut.
    pub fn skeleton(&self) -> &BitImage {
        &self.skeleton
    }

    /// Nodes and edges.
    pub fn graph(&self) -> &Graph {
        &self.graph
    }

    /// Nodes with the bends of edges among them.
    pub fn nodes(&self) -> &[ImageNode] {
        self.image_nodes.nodes()
    }

    /// The luma of `frame`, which must be the one of the last run.
    pub(crate) fn luma<'a>(&'a self, frame: &'a Frame) -> &'a Frame {
        let raw = if frame.format == PixelFormat::Mjpeg { self.decoder.raw() } else { frame };
        if raw.format == PixelFormat::Grey { raw } else { self.luma.plane() }
    }
}

/// Luma from which a camera is taken to be saturated.
const WHITE_LUMA_MIN: u8 = 250;

/// Whether 99 of 100 pixels are saturated; every fourth pixel of every fourth row is looked at.
fn is_white(luma: &Frame) -> bool {
    let Some(view) = LumaView::new(luma) else { return false };
    let places = (0..luma.height).step_by(4).flat_map(|y| (0..luma.width).step_by(4).map(move |x| (x, y)));
    let (mut white, mut all) = (0usize, 0usize);
    for (x, y) in places {
        all += 1;
        white += usize::from(view.at(x, y) >= WHITE_LUMA_MIN);
    }
    100 * white >= 99 * all
}
