//! The controls of a camera: what `cell.toml` asks → what is set, in which order, and whether it was taken.
//!
//! Pure but for the two closures of [`apply`], which set and read one control. Automatics come first, because a
//! value that an automatic decides cannot be set (EACCES). Drivers clamp silently and set what the camera likes,
//! so that every control is checked against its range before and read back after.

use std::collections::BTreeMap;
use std::io;

use super::device::{ControlInfo, ControlKind, control_name};
use crate::config::ControlValue;

/// Controls that switch an automatic: white balance, gain, hue, brightness, exposure, exposure priority, focus,
/// white balance preset, ISO.
const AUTOMATICS: [u32; 9] = [
    0x0098_090c,
    0x0098_0912,
    0x0098_0919,
    0x0098_0920,
    0x009a_0901,
    0x009a_0903,
    0x009a_090c,
    0x009a_0914,
    0x009a_0918,
];

/// Other names of controls: those of older kernels, and the short ones. A control of exactly that name goes first.
const ALIASES: [(u32, &[&str]); 9] = [
    (0x0098_090c, &["white_balance_automatic", "white_balance_temperature_auto", "white_balance_auto"]),
    (0x0098_0912, &["gain_automatic", "auto_gain", "autogain"]),
    (0x0098_091a, &["white_balance_temperature", "white_balance"]),
    (0x0098_0918, &["power_line_frequency"]),
    (0x009a_0901, &["auto_exposure", "exposure_auto"]),
    (0x009a_0902, &["exposure_time_absolute", "exposure_absolute", "exposure"]),
    (0x009a_0903, &["exposure_dynamic_framerate", "exposure_auto_priority"]),
    (0x009a_090a, &["focus_absolute", "focus"]),
    (0x009a_090c, &["focus_automatic_continuous", "focus_auto", "auto_focus"]),
];

/// A control that cannot be what `cell.toml` says.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ControlFault {
    /// The camera has none of this name.
    #[error("control {name}: this camera has none of that name; it has: {offered}")]
    Unknown {
        /// As written.
        name: String,
        /// The names it has.
        offered: String,
    },
    /// It can only be read.
    #[error("control {name}: it can only be read; take it out of the controls")]
    ReadOnly {
        /// As written.
        name: String,
    },
    /// Not a number, a switch or an entry of this control.
    #[error("control {name} = {value}: allowed: {allowed}")]
    NotAllowed {
        /// As written.
        name: String,
        /// As written.
        value: String,
        /// Range or entries.
        allowed: String,
    },
    /// An automatic decides it.
    #[error("control {name} = {value}: an automatic decides it now; set {automatics} as well")]
    Automatic {
        /// As written.
        name: String,
        /// As written.
        value: String,
        /// The automatics of this camera.
        automatics: String,
    },
    /// The driver refuses.
    #[error("control {name} = {value}: the camera refuses it: {reason}")]
    Refused {
        /// As written.
        name: String,
        /// What was to be set.
        value: i64,
        /// What the system said.
        reason: String,
    },
    /// The camera took another value.
    #[error("control {name} = {value}: the camera made {taken} of it; write a value that it takes")]
    Changed {
        /// As written.
        name: String,
        /// What was set.
        value: i64,
        /// What it reads.
        taken: i64,
    },
}

/// One control to be set.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Setting {
    /// The control.
    pub control: ControlInfo,
    /// Its name in `cell.toml`.
    pub name: String,
    /// Its value as the driver takes it.
    pub value: i64,
}

/// What to set, automatics first.
///
/// # Errors
/// A name that the camera lacks, or a value that it does not allow.
pub fn plan(
    offered: &[ControlInfo],
    wanted: &BTreeMap<String, ControlValue>,
) -> Result<Vec<Setting>, ControlFault> {
    let mut settings = Vec::with_capacity(wanted.len());
    for (name, value) in wanted {
        let control = find(offered, name).ok_or_else(|| ControlFault::Unknown {
            name: name.clone(),
            offered: offered.iter().map(|control| control.name.as_str()).collect::<Vec<_>>().join(", "),
        })?;
        if control.read_only {
            return Err(ControlFault::ReadOnly { name: name.clone() });
        }
        let number = number(control, value).ok_or_else(|| ControlFault::NotAllowed {
            name: name.clone(),
            value: written(value),
            allowed: allowed(control),
        })?;
        settings.push(Setting { control: control.clone(), name: name.clone(), value: number });
    }
    settings.sort_by_key(|setting| (!AUTOMATICS.contains(&setting.control.id), setting.control.id));
    Ok(settings)
}

/// Sets what was planned and reads it back. `look` gives a control as it is now, `set` writes it, `get` reads it
/// (`None` where it has no value).
///
/// # Errors
/// The first control that is not afterwards what it should be.
pub fn apply(
    plan: &[Setting],
    mut look: impl FnMut(&ControlInfo) -> io::Result<ControlInfo>,
    mut set: impl FnMut(&ControlInfo, i64) -> io::Result<()>,
    mut get: impl FnMut(&ControlInfo) -> io::Result<Option<i64>>,
) -> Result<(), ControlFault> {
    for setting in plan {
        let Setting { control, name, value } = setting;
        let automatic = || ControlFault::Automatic {
            name: name.clone(),
            value: value.to_string(),
            automatics: automatics(control.id).to_owned(),
        };
        if look(control).is_ok_and(|now| now.inactive) {
            return Err(automatic());
        }
        set(control, *value).map_err(|error| match error.raw_os_error() {
            Some(libc::EACCES) => automatic(),
            _ => ControlFault::Refused { name: name.clone(), value: *value, reason: error.to_string() },
        })?;
    }
    // Only now: setting one control may have moved another.
    for Setting { control, name, value } in plan {
        match get(control) {
            Ok(Some(taken)) if taken != *value => {
                return Err(ControlFault::Changed { name: name.clone(), value: *value, taken });
            }
            Ok(_) => {}
            Err(error) => {
                let reason = format!("it cannot be read back: {error}");
                return Err(ControlFault::Refused { name: name.clone(), value: *value, reason });
            }
        }
    }
    Ok(())
}

fn find<'a>(offered: &'a [ControlInfo], name: &str) -> Option<&'a ControlInfo> {
    let name = control_name(name);
    offered.iter().find(|control| control.name == name).or_else(|| {
        let (id, _) = ALIASES.iter().find(|(_, names)| names.contains(&name.as_str()))?;
        offered.iter().find(|control| control.id == *id)
    })
}

/// The automatic that usually decides a control.
fn automatics(id: u32) -> &'static str {
    match id {
        0x009a_0902 | 0x0098_0911 => "auto_exposure = \"Manual Mode\"",
        0x0098_091a | 0x0098_090e | 0x0098_090f => "white_balance_automatic = false",
        0x009a_090a => "focus_automatic_continuous = false",
        0x0098_0913 => "gain_automatic = false or auto_exposure = \"Manual Mode\"",
        0x0098_0903 => "hue_auto = false",
        _ => "the automatic that belongs to it to false",
    }
}

fn written(value: &ControlValue) -> String {
    match value {
        ControlValue::Integer(number) => number.to_string(),
        ControlValue::Boolean(on) => on.to_string(),
        ControlValue::Name(name) => format!("{name:?}"),
    }
}

fn number(control: &ControlInfo, value: &ControlValue) -> Option<i64> {
    let in_range = |n: i64| {
        let steps = (n.checked_sub(control.minimum)? as u64).is_multiple_of(control.step);
        (n >= control.minimum && n <= control.maximum && steps).then_some(n)
    };
    match (control.kind, value) {
        (ControlKind::Integer | ControlKind::Integer64, ControlValue::Integer(n)) => in_range(*n),
        (ControlKind::Bitmask, ControlValue::Integer(n)) => (n & !control.maximum == 0).then_some(*n),
        (ControlKind::Boolean, ControlValue::Boolean(on)) => Some((*on).into()),
        (ControlKind::Boolean, ControlValue::Integer(n @ (0 | 1))) => Some(*n),
        (ControlKind::Button, ControlValue::Boolean(true)) => Some(1),
        (ControlKind::Menu, ControlValue::Integer(n)) => {
            control.menu.iter().any(|(index, _)| index == n).then_some(*n)
        }
        (ControlKind::Menu | ControlKind::IntegerMenu, ControlValue::Name(name)) => {
            let mut entries = control.menu.iter();
            entries.find(|(_, entry)| entry.eq_ignore_ascii_case(name.trim())).map(|(index, _)| *index)
        }
        (ControlKind::IntegerMenu, ControlValue::Integer(n)) => {
            let n = n.to_string();
            control.menu.iter().find(|(_, entry)| *entry == n).map(|(index, _)| *index)
        }
        _ => None,
    }
}

fn allowed(control: &ControlInfo) -> String {
    let entries = |quote: &str| {
        let entry = |(index, name): &(i64, String)| match quote {
            "" => name.clone(),
            _ => format!("{quote}{name}{quote} ({index})"),
        };
        control.menu.iter().map(entry).collect::<Vec<_>>().join(", ")
    };
    match control.kind {
        ControlKind::Integer | ControlKind::Integer64 if control.step == 1 => {
            format!("{} to {}", control.minimum, control.maximum)
        }
        ControlKind::Integer | ControlKind::Integer64 => {
            format!("{} to {} in steps of {}", control.minimum, control.maximum, control.step)
        }
        ControlKind::Boolean => "true, false".to_owned(),
        ControlKind::Menu => entries("\""),
        ControlKind::IntegerMenu => entries(""),
        ControlKind::Bitmask => format!("bits of {:#x}", control.maximum),
        ControlKind::Button => "true".to_owned(),
        ControlKind::Other => "nothing: such a control cannot be set from here".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;

    fn control(id: u32, name: &str, kind: ControlKind, range: (i64, i64, u64)) -> ControlInfo {
        ControlInfo {
            id,
            name: name.to_owned(),
            kind,
            minimum: range.0,
            maximum: range.1,
            step: range.2,
            default: range.0,
            menu: Vec::new(),
            read_only: false,
            inactive: false,
        }
    }

    /// What a usual webcam offers.
    fn webcam() -> Vec<ControlInfo> {
        let mut exposure = control(0x009a_0901, "auto_exposure", ControlKind::Menu, (0, 3, 1));
        exposure.menu = vec![(1, "Manual Mode".to_owned()), (3, "Aperture Priority Mode".to_owned())];
        let mut iso = control(0x009a_0917, "iso_sensitivity", ControlKind::IntegerMenu, (0, 1, 1));
        iso.menu = vec![(0, "100".to_owned()), (1, "200".to_owned())];
        let mut focus = control(0x009a_090a, "focus_absolute", ControlKind::Integer, (0, 250, 5));
        focus.read_only = true;
        vec![
            control(0x0098_0913, "gain", ControlKind::Integer, (0, 100, 5)),
            control(0x0098_090c, "white_balance_automatic", ControlKind::Boolean, (0, 1, 1)),
            exposure,
            control(0x009a_0902, "exposure_time_absolute", ControlKind::Integer, (3, 2047, 1)),
            iso,
            focus,
        ]
    }

    fn wanted(pairs: &[(&str, ControlValue)]) -> BTreeMap<String, ControlValue> {
        pairs.iter().map(|(name, value)| ((*name).to_owned(), value.clone())).collect()
    }

    fn complaint(name: &str, value: ControlValue) -> String {
        plan(&webcam(), &wanted(&[(name, value)])).expect_err("not possible").to_string()
    }

    #[test]
    fn automatics_come_first_and_menus_go_by_name_or_number() {
        let name = |name: &str| ControlValue::Name(name.to_owned());
        let plan = plan(
            &webcam(),
            &wanted(&[
                ("exposure_time_absolute", ControlValue::Integer(150)),
                ("auto_exposure", name("manual mode")),
                ("gain", ControlValue::Integer(10)),
                ("white_balance_automatic", ControlValue::Boolean(false)),
                ("iso_sensitivity", ControlValue::Integer(200)),
            ]),
        );
        let order: Vec<_> = plan.expect("a plan").into_iter().map(|s| (s.name, s.value)).collect();
        let order: Vec<_> = order.iter().map(|(name, value)| (name.as_str(), *value)).collect();
        let expected = [
            ("white_balance_automatic", 0),
            ("auto_exposure", 1),
            ("gain", 10),
            ("exposure_time_absolute", 150),
            ("iso_sensitivity", 1),
        ];
        assert_eq!(order, expected);
    }

    #[test]
    fn older_and_shorter_names_find_the_same_control() {
        for name in ["exposure_absolute", "exposure", "Exposure Time, Absolute"] {
            let plan = plan(&webcam(), &wanted(&[(name, ControlValue::Integer(150))])).expect("a plan");
            assert_eq!(plan[0].control.name, "exposure_time_absolute");
        }
    }

    #[test]
    fn what_the_camera_lacks_or_does_not_allow_is_told() {
        assert_eq!(
            complaint("zoom", ControlValue::Integer(1)),
            "control zoom: this camera has none of that name; it has: gain, white_balance_automatic, \
             auto_exposure, exposure_time_absolute, iso_sensitivity, focus_absolute"
        );
        assert_eq!(
            complaint("gain", ControlValue::Integer(7)),
            "control gain = 7: allowed: 0 to 100 in steps of 5"
        );
        assert_eq!(
            complaint("auto_exposure", ControlValue::Integer(0)),
            "control auto_exposure = 0: allowed: \"Manual Mode\" (1), \"Aperture Priority Mode\" (3)"
        );
        assert_eq!(
            complaint("iso_sensitivity", ControlValue::Integer(150)),
            "control iso_sensitivity = 150: allowed: 100, 200"
        );
        assert_eq!(
            complaint("white_balance_automatic", ControlValue::Name("off".to_owned())),
            "control white_balance_automatic = \"off\": allowed: true, false"
        );
        assert_eq!(
            complaint("focus", ControlValue::Integer(5)),
            "control focus: it can only be read; take it out of the controls"
        );
    }

    /// Applies to a camera that behaves as `set` says, which gets all values and the one to be set.
    fn applied(
        pairs: &[(&str, ControlValue)],
        set: impl Fn(&mut BTreeMap<u32, i64>, u32, i64) -> io::Result<()>,
    ) -> Result<(), ControlFault> {
        let values = RefCell::new(BTreeMap::from([(0x009a_0901, 3)]));
        let manual = |values: &BTreeMap<u32, i64>| values[&0x009a_0901] == 1;
        apply(
            &plan(&webcam(), &wanted(pairs))?,
            |control| {
                let inactive = control.id == 0x009a_0902 && !manual(&values.borrow());
                Ok(ControlInfo { inactive, ..control.clone() })
            },
            |control, value| set(&mut values.borrow_mut(), control.id, value),
            |control| Ok(values.borrow().get(&control.id).copied()),
        )
    }

    fn honest(values: &mut BTreeMap<u32, i64>, id: u32, value: i64) -> io::Result<()> {
        values.insert(id, value);
        Ok(())
    }

    #[test]
    fn a_value_that_an_automatic_decides_is_refused_with_the_remedy() {
        let exposure = ("exposure_time_absolute", ControlValue::Integer(150));
        let manual = ("auto_exposure", ControlValue::Integer(1));
        assert_eq!(applied(&[exposure.clone(), manual], honest), Ok(()));
        assert_eq!(
            applied(&[exposure], honest).expect_err("automatic").to_string(),
            "control exposure_time_absolute = 150: an automatic decides it now; set auto_exposure = \"Manual Mode\" \
             as well"
        );
    }

    #[test]
    fn a_value_that_does_not_stay_is_noticed() {
        let clamp = |values: &mut BTreeMap<u32, i64>, id, value: i64| honest(values, id, value.min(50));
        assert_eq!(
            applied(&[("gain", ControlValue::Integer(80))], clamp).expect_err("clamped").to_string(),
            "control gain = 80: the camera made 50 of it; write a value that it takes"
        );
        let refuse = |_: &mut BTreeMap<u32, i64>, _, _| Err(io::Error::from_raw_os_error(libc::EIO));
        let message =
            applied(&[("gain", ControlValue::Integer(80))], refuse).expect_err("refused").to_string();
        assert!(message.starts_with("control gain = 80: the camera refuses it: "), "{message}");
    }
}
