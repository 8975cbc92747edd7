//! What a given range of colours leaves open: whether parts are darker than the floor, and whether grey values tell them from it
//! at all.
//!
//! A threshold that is found looks for bright or for dark parts as it is told. A range of colours may be the parts' or, inverted,
//! the floor's, and takes walls and shadows as well. The pictures tell: where rough poses have their wire, and all along the graphs'
//! edges, for in clutter such poses are few.

use super::lighting::Lighting;
use super::views::views;
use super::{Recognizer, rig_of};
use crate::frame::{FramePair, PixelFormat};
use crate::picture::Picture;
use crate::pose::beside::{along_part, contrast};
use crate::pose::section::CONTRAST_MIN;
use crate::time::Timestamp;
use crate::vision::beside::along_edges;
use crate::vision::binarize::ColourRange;
use crate::vision::hue::Colours;

/// Most rough poses that are asked, the fittest first; the least places that tell, in each picture, and the most that are asked there.
const POSES_MAX: usize = 48;
const PLACES_MIN: usize = 12;
pub(super) const PLACES_MAX: usize = 256;
/// From this contrast on, in levels, outlines in colours that are sent in half the resolution are displaced no more than those in luma.
const CLEAN_HUE: f64 = 120.0;

/// Where the places lie that are asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Source {
    RoughPoses,
    Graphs,
}

impl Recognizer {
    /// Has colours stand for grey values in both pictures from here on, where they tell parts from the floor and luma does not; and
    /// finds out whether parts are darker. The first is judged once a pair, and left where it is not done by `end`.
    pub(super) fn judge_colours(&mut self, pair: &FramePair, end: Option<Timestamp>) {
        let ranges = self.pictures.each_ref().map(Picture::range);
        let dark = ranges.iter().any(|range| range.inverted);
        let are_found = ranges.iter().all(|range| range.colour == ColourRange::Auto);
        self.lighting.dark = dark;
        if are_found {
            return;
        }
        let mut brighter = 0.0;
        for source in [Source::RoughPoses, Source::Graphs] {
            self.find_places(pair, source);
            if !self.lighting.is_hue_judged && self.look_in_hue(pair, end) {
                // What luma said tells nothing.
                brighter = 0.0;
            }
            brighter += self.are_brighter(pair);
        }
        self.lighting.is_hue_judged = true;
        if brighter != 0.0 {
            self.lighting.dark = brighter < 0.0;
        }
    }

    /// Fills in the places; none where one of the pictures has hardly any.
    fn find_places(&mut self, pair: &FramePair, source: Source) {
        let Self { pictures, scales, parts, pool, places, .. } = self;
        places.iter_mut().for_each(Vec::clear);
        let Some(views) = views(pictures, rig_of(scales, pictures), pair, Lighting::default()) else {
            return;
        };
        for ((places, view), picture) in places.iter_mut().zip(&views).zip(&*pictures) {
            let poses = pool.iter().take(POSES_MAX).map(|h| (parts[h.part].pose_model(), &h.left_from_part));
            match source {
                Source::RoughPoses => {
                    let of_poses = poses.flat_map(|(model, pose)| along_part(model, pose, view));
                    places.extend(of_poses.take(PLACES_MAX));
                }
                Source::Graphs => {
                    places.extend(along_edges(picture.graph(), picture.mask(), PLACES_MAX));
                }
            }
        }
        if places.iter().any(|places| places.len() < PLACES_MIN) {
            places.iter_mut().for_each(Vec::clear);
        }
    }

    /// Says whether colours stand for grey values from here on.
    fn look_in_hue(&mut self, pair: &FramePair, end: Option<Timestamp>) -> bool {
        let Self { pictures, places, lighting, .. } = self;
        let frames = [&pair.left, &pair.right];
        let colours = [0, 1].map(|side: usize| pictures[side].colours(frames[side], &places[side]));
        let [Some(left), Some(right)] = &colours else { return false };
        let tell = Colours::tell_more_than_luma([left, right])
            && pictures[0].write_hue(frames[0], left, end)
            && pictures[1].write_hue(frames[1], right, end);
        if tell {
            let least = left.hue_contrast().min(right.hue_contrast());
            let is_halved =
                |format| matches!(format, PixelFormat::Mjpeg | PixelFormat::Yuyv | PixelFormat::Nv12);
            let is_coarse = frames.iter().any(|frame| is_halved(frame.format));
            lighting.displaced_times = if is_coarse { (CLEAN_HUE / least).max(1.0) } else { 1.0 };
            pictures.iter_mut().for_each(Picture::look_in_hue);
        }
        tell
    }

    /// What speaks for wire being brighter than the floor beside it, at all places together: signed squares of grey levels, for
    /// walls and shadows, of which there may be more, stand out less than parts do.
    fn are_brighter(&self, pair: &FramePair) -> f64 {
        let Self { pictures, scales, places, .. } = self;
        let Some(views) = views(pictures, rig_of(scales, pictures), pair, Lighting::default()) else {
            return 0.0;
        };
        let of_both = places.iter().zip(&views);
        let contrasts = of_both.flat_map(|(places, view)| places.iter().map(|place| contrast(place, view)));
        contrasts.filter(|c| c.abs() >= CONTRAST_MIN).map(|c| c * c.abs()).sum()
    }
}
