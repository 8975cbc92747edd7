//! Drawn pictures for benches and tests: bright rods with soft borders on a dark floor, with noise, from a seed.

#![allow(dead_code, missing_docs, unreachable_pub)]

use pickcell::frame::Frame;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// A rod as it was drawn.
#[derive(Clone, Copy, Debug)]
pub struct Rod {
    /// Its two ends, in pixels, pixel centres at whole numbers.
    pub ends_px: [[f32; 2]; 2],
    /// Half its thickness.
    pub half_thickness_px: f32,
}

/// `count` rods of 60 to 160 pixels length and 6 to 9 pixels thickness that lie inside the picture.
pub fn rods(width: usize, height: usize, count: usize, seed: u64) -> Vec<Rod> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut rods = Vec::with_capacity(count);
    while rods.len() < count {
        let length: f32 = random.random_range(60.0..160.0);
        let angle: f32 = random.random_range(0.0..std::f32::consts::PI);
        let half_thickness_px = random.random_range(3.0..4.5);
        let centre = [random.random_range(0.0..width as f32), random.random_range(0.0..height as f32)];
        let (dx, dy) = (angle.cos() * length / 2.0, angle.sin() * length / 2.0);
        let ends_px = [[centre[0] - dx, centre[1] - dy], [centre[0] + dx, centre[1] + dy]];
        let margin = 8.0;
        let inside = |p: [f32; 2]| {
            (margin..width as f32 - margin).contains(&p[0])
                && (margin..height as f32 - margin).contains(&p[1])
        };
        if ends_px.into_iter().all(inside) {
            rods.push(Rod { ends_px, half_thickness_px });
        }
    }
    rods
}

/// The rods as a grey picture: floor 40, rods 200, flat ends, borders soft over a pixel, noise of +-8 levels.
pub fn grey(width: usize, height: usize, rods: &[Rod], seed: u64) -> Vec<u8> {
    let mut light = vec![0.0f32; width * height];
    for rod in rods {
        let [a, b] = rod.ends_px;
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let length = dx.hypot(dy);
        let (ux, uy) = (dx / length, dy / length);
        let reach = rod.half_thickness_px + 2.0;
        let span = |p: f32, q: f32, size: usize| {
            let low = (p.min(q) - reach).max(0.0) as usize;
            low..((p.max(q) + reach) as usize + 1).min(size)
        };
        for y in span(a[1], b[1], height) {
            for x in span(a[0], b[0], width) {
                let (px, py) = (x as f32 - a[0], y as f32 - a[1]);
                let (along, across) = (px * ux + py * uy, (py * ux - px * uy).abs());
                let cover = |depth: f32| (depth + 0.5).clamp(0.0, 1.0);
                let covered = cover(rod.half_thickness_px - across) * cover(along) * cover(length - along);
                let pixel = &mut light[y * width + x];
                *pixel = pixel.max(covered);
            }
        }
    }
    let mut random = Pcg64Mcg::seed_from_u64(seed ^ 0x6e6f697365);
    light.iter().map(|covered| (40.0 + 160.0 * covered + random.random_range(-8.0..8.0)) as u8).collect()
}

/// The same as an RGB frame; red, green and blue are the grey value with a little noise of their own.
pub fn frame(width: usize, height: usize, rods: &[Rod], seed: u64) -> Frame {
    let mut random = Pcg64Mcg::seed_from_u64(seed ^ 0x636f6c6f7572);
    let grey = grey(width, height, rods, seed);
    let bytes =
        grey.iter().flat_map(|&v| [0; 3].map(|_: u8| v.saturating_add(random.random_range(0..4)))).collect();
    Frame::from_rgb(width, height, bytes)
}

/// A pair: the right picture has the rods some pixels to the left, each by its own disparity.
pub fn pair(width: usize, height: usize, count: usize, seed: u64) -> [Frame; 2] {
    let left = rods(width, height, count, seed);
    let mut random = Pcg64Mcg::seed_from_u64(seed ^ 0x72696768);
    let right: Vec<Rod> = left
        .iter()
        .map(|rod| {
            let disparity = random.random_range(0.0..8.0);
            Rod { ends_px: rod.ends_px.map(|p| [p[0] - disparity, p[1]]), ..*rod }
        })
        .collect();
    [frame(width, height, &left, seed), frame(width, height, &right, seed + 1)]
}
