//! `cell.toml`, checked → the parameters of recognition. The stages know no configuration; this is where it ends.

use crate::config::{Cell, Gate};
use crate::recognize::Params;

/// Specks of fewer pixels are dropped where nothing else is said.
const SPECK_PX_MIN: u32 = 20;

/// The parameters where there is no cell.
pub fn plain() -> Params {
    let mut params = Params::default();
    params.binarize.iter_mut().for_each(|pixels| pixels.speck_px_min = SPECK_PX_MIN);
    params
}

/// The parameters of a cell.
pub fn of_cell(cell: &Cell) -> Params {
    let mut params = plain();
    let written = &cell.recognition;
    for (pixels, region) in
        params.binarize.iter_mut().zip([&written.region_left_px, &written.region_right_px])
    {
        pixels.colour = written.colour;
        pixels.inverted = written.inverted;
        pixels.speck_px_min = written.min_speck_px;
        pixels.region_px.clone_from(region);
    }
    params.thin.algorithm = written.thin;
    set_gate(&mut params, written.gate);
    if let Some(fitness_max) = written.fitness_max {
        params.search.fitness_max = fitness_max;
    }
    let (arm, grasp) = (&cell.arm_side.arm, &mut params.grasp);
    grasp.base_from_left = cell.rig.base_from_left;
    grasp.workspace = Some(cell.arm_side.workspace);
    grasp.gripper = cell.arm_side.gripper;
    grasp.axes = arm.axes;
    grasp.tilt_tolerance_rad = arm.tilt_tolerance_deg.to_radians();
    grasp.yaw_tolerance_rad = arm.yaw_tolerance_deg.to_radians();
    params
}

/// Which nodes of the right picture go with a node of the left one.
pub fn set_gate(params: &mut Params, gate: Gate) {
    let epipolar = Params::default().gate;
    let (gap, junction_gap) = match gate {
        Gate::Epipolar => (epipolar.gap_px_max, epipolar.junction_gap_px_max),
        Gate::None => (f64::INFINITY, f64::INFINITY),
    };
    params.gate.gap_px_max = gap;
    params.gate.junction_gap_px_max = junction_gap;
}

#[cfg(test)]
mod tests {
    use super::*;
    use firmware_bridge::message::ArmAxes;
    use std::path::Path;

    #[test]
    fn what_the_projects_cell_says_arrives() {
        let cell = Cell::read(&Path::new(env!("CARGO_MANIFEST_DIR")).join("cell.toml")).unwrap();
        let params = of_cell(&cell);
        assert_eq!(params.binarize[0].speck_px_min, cell.recognition.min_speck_px);
        assert_eq!(params.grasp.base_from_left, cell.rig.base_from_left);
        assert_eq!(params.grasp.workspace, Some(cell.arm_side.workspace));
        let mut other = cell.clone();
        other.recognition.inverted = true;
        other.recognition.region_right_px = vec![[0.0, 0.0], [9.0, 0.0], [9.0, 9.0]];
        other.recognition.fitness_max = Some(0.25);
        other.recognition.gate = Gate::None;
        other.arm_side.arm.axes = ArmAxes::Xyz;
        let params = of_cell(&other);
        assert!(params.binarize.iter().all(|p| p.inverted));
        assert_eq!((params.binarize[0].region_px.len(), params.binarize[1].region_px.len()), (0, 3));
        assert_eq!((params.search.fitness_max, params.grasp.axes), (0.25, ArmAxes::Xyz));
        assert!(params.gate.gap_px_max.is_infinite());
    }
}
