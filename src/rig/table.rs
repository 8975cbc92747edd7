//! Undistortion by look-up, for code that undistorts thousands of points a picture.

use nalgebra::Vector2;

use super::CameraModel;

/// Normalised coordinates at every few pixels, bilinear between them. Outside of the picture (by more than one
/// grid step) it falls back to [`CameraModel::undistort`].
#[derive(Clone, Debug)]
pub struct UndistortTable {
    camera: CameraModel,
    step_px: f64,
    columns: usize,
    rows: usize,
    nodes: Vec<Vector2<f64>>,
    error_px: f64,
}

impl UndistortTable {
    /// The table with the widest grid of 32, 16, 8, 4 or 2 pixels whose error is at most `error_max_px` (0.005 is
    /// a twentieth of what a good node measures; the 2 pixel grid is taken where none is good enough). The error
    /// is measured in the middle of every cell, where that of bilinear interpolation is greatest.
    pub fn new(camera: &CameraModel, error_max_px: f64) -> Self {
        let mut step = 32;
        loop {
            let table = Self::with_step(camera, step);
            if table.error_px <= error_max_px || step <= 2 {
                return table;
            }
            step /= 2;
        }
    }

    fn with_step(camera: &CameraModel, step: usize) -> Self {
        // one more cell on all sides, so that sub-pixel points at the border are inside
        let (columns, rows) = (camera.width.div_ceil(step) + 3, camera.height.div_ceil(step) + 3);
        let step_px = step as f64;
        let place = |i: usize| (i as f64 - 1.0) * step_px;
        let nodes = (0..columns * rows)
            .map(|i| camera.undistort(Vector2::new(place(i % columns), place(i / columns))))
            .collect();
        let mut table = Self { camera: *camera, step_px, columns, rows, nodes, error_px: 0.0 };
        for row in 1..rows - 2 {
            for column in 1..columns - 2 {
                let px = Vector2::new(place(column) + 0.5 * step_px, place(row) + 0.5 * step_px);
                if camera.sees(px, 0.0) {
                    let back = camera.distort(table.undistort(px));
                    table.error_px = table.error_px.max((back - px).norm());
                }
            }
        }
        table
    }

    /// The greatest error that was measured inside the picture, in pixels.
    pub fn error_px(&self) -> f64 {
        self.error_px
    }

    /// Distorted pixels to normalised image coordinates.
    #[inline]
    pub fn undistort(&self, px: Vector2<f64>) -> Vector2<f64> {
        let (u, v) = (px.x / self.step_px + 1.0, px.y / self.step_px + 1.0);
        if !(u >= 0.0 && v >= 0.0 && u < (self.columns - 1) as f64 && v < (self.rows - 1) as f64) {
            return self.camera.undistort(px);
        }
        let (column, row) = (u as usize, v as usize);
        let (s, t) = (u - column as f64, v - row as f64);
        let upper = row * self.columns + column;
        let lower = upper + self.columns;
        let above = self.nodes[upper] * (1.0 - s) + self.nodes[upper + 1] * s;
        let below = self.nodes[lower] * (1.0 - s) + self.nodes[lower + 1] * s;
        above * (1.0 - t) + below * t
    }
}
