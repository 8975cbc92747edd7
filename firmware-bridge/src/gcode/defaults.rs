//! The moves that every dialect has of its own, so that an engineer needs none for a first pick.
//!
//! All of them: across to above the part at the height of the highest pose, down along the approach, close, up along
//! the retreat, across to above the place, down, open, up. Speeds are mm/min. They do not turn the tool, but for the uArm's wrist. The
//! fingers are open when a pick begins (`start` and the end of every list see to it), so the first line is a move.

use crate::config::DialectName;
use crate::message::ArmAxes;

/// The lists of a dialect.
pub(crate) struct Own {
    pub(crate) start: &'static [&'static str],
    pub(crate) pick: &'static [&'static str],
    pub(crate) missed: &'static [&'static str],
}

/// Grbl has no servo: coolant is the output that every board brings out, and a reset switches it off. The relay or
/// valve on it closes the fingers.
const GRBL: Own = Own {
    start: &["M9"],
    pick: &[
        "G0 X{approach_x} Y{approach_y} Z{travel_z}",
        "G0 Z{approach_z}",
        "G1 X{grasp_x} Y{grasp_y} Z{grasp_z} F1500",
        "M8",
        "G4 P0.4",
        "G1 X{retreat_x} Y{retreat_y} Z{retreat_z} F3000",
        "G0 X{place_x} Y{place_y} Z{travel_z}",
        "G1 Z{place_z} F1500",
        "M9",
        "G4 P0.4",
        "G0 Z{travel_z}",
    ],
    missed: &["M9", "G4 P0.4", "G0 Z{travel_z}"],
};

/// The fan output of a printer board switches the valve or pump.
const MARLIN: Own = Own {
    start: &["M107"],
    pick: &[
        "G0 X{approach_x} Y{approach_y} Z{travel_z} F6000",
        "G0 Z{approach_z} F6000",
        "G1 X{grasp_x} Y{grasp_y} Z{grasp_z} F1500",
        "M106 S255",
        "G4 P400",
        "G1 X{retreat_x} Y{retreat_y} Z{retreat_z} F3000",
        "G0 X{place_x} Y{place_y} Z{travel_z} F6000",
        "G1 Z{place_z} F1500",
        "M107",
        "G4 P400",
        "G0 Z{travel_z} F6000",
    ],
    missed: &["M107", "G4 P400", "G0 Z{travel_z} F6000"],
};

/// Whole points only: the uArm's reach is a shell, and a move of one coordinate may leave it.
const UARM: Own = Own {
    start: &["M2232 V0"],
    pick: &[
        "G0 X{approach_x} Y{approach_y} Z{travel_z} F6000",
        "G0 X{approach_x} Y{approach_y} Z{approach_z} F6000",
        "G1 X{grasp_x} Y{grasp_y} Z{grasp_z} F1500",
        "M2232 V1",
        "G4 P800",
        "G1 X{retreat_x} Y{retreat_y} Z{retreat_z} F3000",
        "G0 X{place_x} Y{place_y} Z{travel_z} F6000",
        "G1 X{place_x} Y{place_y} Z{place_z} F1500",
        "M2232 V0",
        "G4 P800",
        "G0 X{place_x} Y{place_y} Z{travel_z} F6000",
    ],
    missed: &["M2232 V0", "G4 P800", "G0 X{retreat_x} Y{retreat_y} Z{travel_z} F6000"],
};

/// The same with the wrist turned above the part and above its place.
const UARM_YAW: Own = Own {
    start: UARM.start,
    pick: &[
        "G0 X{approach_x} Y{approach_y} Z{travel_z} F6000",
        "G2202 N3 V{grasp_wrist} F1000",
        "G4 P500",
        "G0 X{approach_x} Y{approach_y} Z{approach_z} F6000",
        "G1 X{grasp_x} Y{grasp_y} Z{grasp_z} F1500",
        "M2232 V1",
        "G4 P800",
        "G1 X{retreat_x} Y{retreat_y} Z{retreat_z} F3000",
        "G0 X{place_x} Y{place_y} Z{travel_z} F6000",
        "G2202 N3 V{place_wrist} F1000",
        "G4 P500",
        "G1 X{place_x} Y{place_y} Z{place_z} F1500",
        "M2232 V0",
        "G4 P800",
        "G0 X{place_x} Y{place_y} Z{travel_z} F6000",
    ],
    missed: UARM.missed,
};

/// The moves of a dialect.
pub(crate) fn moves(dialect: DialectName, axes: ArmAxes) -> Own {
    match dialect {
        DialectName::Grbl => GRBL,
        DialectName::Marlin => MARLIN,
        DialectName::Uarm if axes == ArmAxes::XyzYaw => UARM_YAW,
        DialectName::Uarm => UARM,
        DialectName::Own => Own { start: &[], pick: &[], missed: &[] },
    }
}

/// A dialect's name as in cell.toml.
pub(crate) fn name(dialect: DialectName) -> &'static str {
    match dialect {
        DialectName::Own => "own",
        DialectName::Grbl => "grbl",
        DialectName::Marlin => "marlin",
        DialectName::Uarm => "uarm",
    }
}

/// What can be asked for `arm.moves.held`: Grbl shows its inputs in the status report (`Pn:P` = probe input).
pub(crate) fn held_questions(dialect: DialectName) -> &'static str {
    match dialect {
        DialectName::Grbl => "?",
        DialectName::Marlin => "M119",
        DialectName::Uarm => "P2231, P2232, P2233",
        DialectName::Own => "nothing",
    }
}
