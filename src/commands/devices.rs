//! `pickcell devices`: the cameras and serial ports of this machine.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde::Serialize;
use serialport::SerialPortType;

use crate::camera::v4l::device::ControlKind;
use crate::camera::v4l::list::{self, Listed, ListedControl};

const EXAMPLES: &str = "\
Examples:
  pickcell devices
  pickcell devices --format json | jq -r '.cameras[].device'

The first path of a camera or port is the one to write into cell.toml.";

/// List cameras (stable path, formats, sizes, rates, controls) and serial ports
#[derive(Args, Debug)]
#[command(after_help = EXAMPLES)]
pub struct DevicesArgs {
    /// How the list is printed
    #[arg(long, value_enum, default_value_t = Format::Text)]
    format: Format,
}

/// `--format`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// A list for people
    Text,
    /// One JSON object
    Json,
}

/// Everything that is plugged in.
#[derive(Debug, Serialize)]
pub struct Devices {
    /// Cameras.
    pub cameras: Vec<Listed>,
    /// Serial ports.
    pub serial_ports: Vec<SerialPort>,
}

/// A serial port with hardware behind it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SerialPort {
    /// The path to write into cell.toml: a stable one where there is one.
    pub port: PathBuf,
    /// The kernel's node.
    pub node: PathBuf,
    /// What is plugged in, as it says itself; empty for built-in ports.
    pub description: String,
}

impl Devices {
    /// Looks for all of it.
    pub fn find() -> Self {
        Devices { cameras: list::cameras(), serial_ports: serial_ports() }
    }
}

/// Prints the list. Gives what stands on standard output.
pub fn run(args: &DevicesArgs) -> String {
    let devices = Devices::find();
    match args.format {
        Format::Json => format!("{}\n", serde_json::to_string_pretty(&devices).unwrap_or_default()),
        Format::Text => in_words(&devices),
    }
}

fn in_words(devices: &Devices) -> String {
    let mut text = String::new();
    if devices.cameras.is_empty() {
        text += "no cameras: plug them in; backend = \"replay\" needs none\n";
    }
    for camera in &devices.cameras {
        camera_in_words(&mut text, camera);
    }
    if devices.serial_ports.is_empty() {
        text += "no serial ports: `firmware-bridge simulate --pty LINK` makes one with a simulated arm\n";
    }
    for port in &devices.serial_ports {
        let _ = writeln!(text, "serial port {}", port.port.display());
        let _ = match port.description.is_empty() {
            true => writeln!(text, "  {}, built in", port.node.display()),
            false => writeln!(text, "  {}, {}", port.node.display(), port.description),
        };
    }
    text
}

fn camera_in_words(text: &mut String, camera: &Listed) {
    let _ = writeln!(text, "camera {}", camera.device.display());
    let mut about = vec![camera.node.display().to_string()];
    if let Some(identity) = &camera.identity {
        about.push(format!("{} ({})", identity.card, identity.driver));
    }
    if let Some(usb) = &camera.usb {
        about.push(format!("USB bus {}, port {}, {} Mbit/s", usb.bus, usb.port, usb.speed_mbit_s));
    }
    let _ = writeln!(text, "  {}", about.join(", "));
    for other in camera.stable_paths.iter().skip(1) {
        let _ = writeln!(text, "  also {}", other.display());
    }
    if let Some(problem) = &camera.problem {
        let _ = writeln!(text, "  {problem}");
    }
    for format in &camera.formats {
        for size in &format.sizes {
            let rates: Vec<_> = size.rates_hz.iter().map(f64::to_string).collect();
            let rates = rates.join(if size.rates_are_range { " to " } else { ", " });
            let unit = if rates.is_empty() { "" } else { " frames a second" };
            let _ = writeln!(text, "  {:<5} {}  {rates}{unit}", format.format, size.size);
        }
    }
    for control in &camera.controls {
        let _ = writeln!(text, "  {}", control_in_words(control));
    }
}

/// `exposure_time_absolute = 157: 3 to 2047, default 250, an automatic decides it`.
fn control_in_words(control: &ListedControl) -> String {
    let info = &control.info;
    let entry = |index: i64| {
        let name = info.menu.iter().find(|(i, _)| *i == index).map(|(_, name)| name.clone());
        match (info.kind, name) {
            (ControlKind::Menu, Some(name)) => format!("{name:?}"),
            (ControlKind::IntegerMenu, Some(name)) => name,
            (ControlKind::Boolean, _) => (index != 0).to_string(),
            _ => index.to_string(),
        }
    };
    let mut line = info.name.clone();
    if let Some(value) = control.value {
        line += &format!(" = {}", entry(value));
    }
    let mut about = Vec::new();
    match info.kind {
        ControlKind::Integer | ControlKind::Integer64 => {
            about.push(format!("{} to {}", info.minimum, info.maximum));
            if info.step > 1 {
                about.push(format!("in steps of {}", info.step));
            }
        }
        ControlKind::Menu | ControlKind::IntegerMenu => {
            about.push(info.menu.iter().map(|(index, _)| entry(*index)).collect::<Vec<_>>().join(" | "));
        }
        ControlKind::Bitmask => about.push(format!("bits of {:#x}", info.maximum)),
        ControlKind::Button => about.push("true to press it".to_owned()),
        ControlKind::Boolean | ControlKind::Other => {}
    }
    if !matches!(info.kind, ControlKind::Button | ControlKind::Other) {
        about.push(format!("default {}", entry(info.default)));
    }
    if info.read_only {
        about.push("read only".to_owned());
    }
    if info.inactive {
        about.push("an automatic decides it now".to_owned());
    }
    format!("{line}: {}", about.join(", "))
}

/// Serial ports that have hardware behind them; the kernel lists many that have none. The crate `serialport` knows
/// those of the usual buses and what is plugged in there, the kernel's list also those of a board's own.
fn serial_ports() -> Vec<SerialPort> {
    let Ok(entries) = fs::read_dir("/sys/class/tty") else { return Vec::new() };
    let mut ports: BTreeMap<String, String> = entries
        .flatten()
        .filter_map(|entry| entry.file_name().into_string().ok())
        .filter(|name| Path::new("/sys/class/tty").join(name).join("device").exists())
        .map(|name| (name, String::new()))
        .collect();
    for known in serialport::available_ports().unwrap_or_default() {
        let name = known.port_name.trim_start_matches("/dev/").to_owned();
        ports.insert(name, description(known.port_type));
    }
    ports.into_iter().filter_map(|(name, description)| serial_port(&name, description)).collect()
}

/// What is plugged in, as it says itself.
fn description(kind: SerialPortType) -> String {
    let SerialPortType::UsbPort(usb) = kind else { return String::new() };
    let said = [usb.manufacturer, usb.product, usb.serial_number].into_iter().flatten();
    said.filter(|text| !text.is_empty()).collect::<Vec<_>>().join(" ")
}

fn serial_port(name: &str, description: String) -> Option<SerialPort> {
    let class = Path::new("/sys/class/tty").join(name);
    // The 8250 driver makes nodes for ports that a board does not have; their type is 0, "unknown".
    if name.starts_with("ttyS") && fs::read_to_string(class.join("type")).is_ok_and(|t| t.trim() == "0") {
        return None;
    }
    let node = Path::new("/dev").join(name);
    if !node.exists() {
        return None;
    }
    let port = stable_serial(&node).unwrap_or_else(|| node.clone());
    Some(SerialPort { port, node, description })
}

fn stable_serial(node: &Path) -> Option<PathBuf> {
    let real = fs::canonicalize(node).ok()?;
    for folder in ["/dev/serial/by-id", "/dev/serial/by-path"] {
        let Ok(entries) = fs::read_dir(folder) else { continue };
        let mut links: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
        links.sort();
        if let Some(link) = links.into_iter().find(|link| fs::canonicalize(link).is_ok_and(|to| to == real)) {
            return Some(link);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::v4l::device::{ControlInfo, Identity};
    use crate::camera::v4l::format::{OfferedFormat, OfferedSize};
    use crate::camera::v4l::list::UsbPort;

    fn control(name: &str, kind: ControlKind, value: i64) -> ListedControl {
        let menu = match kind {
            ControlKind::Menu => vec![(1, "Manual Mode".to_owned()), (3, "Aperture".to_owned())],
            _ => Vec::new(),
        };
        let info = ControlInfo {
            id: 1,
            name: name.to_owned(),
            kind,
            minimum: 0,
            maximum: 100,
            step: 1,
            default: 1,
            menu,
            read_only: false,
            inactive: kind == ControlKind::Integer,
        };
        ListedControl { info, value: Some(value) }
    }

    fn devices() -> Devices {
        let size =
            OfferedSize { size: "640x480".to_owned(), rates_hz: vec![30.0, 15.0], rates_are_range: false };
        let camera = Listed {
            device: "/dev/v4l/by-path/a".into(),
            node: "/dev/video0".into(),
            stable_paths: vec!["/dev/v4l/by-path/a".into(), "/dev/v4l/by-id/b".into()],
            identity: Some(Identity {
                driver: "uvcvideo".to_owned(),
                card: "Webcam".to_owned(),
                bus: "usb-1".to_owned(),
                captures: true,
            }),
            usb: Some(UsbPort { bus: 1, port: "2.1".to_owned(), speed_mbit_s: 480.0 }),
            formats: vec![OfferedFormat { format: "YUYV".to_owned(), sizes: vec![size] }],
            controls: vec![
                control("gain", ControlKind::Integer, 7),
                control("auto_exposure", ControlKind::Menu, 3),
                control("auto_white", ControlKind::Boolean, 0),
            ],
            problem: None,
        };
        let port = SerialPort {
            port: "/dev/serial/by-id/arm".into(),
            node: "/dev/ttyUSB0".into(),
            description: "FTDI arm".to_owned(),
        };
        Devices { cameras: vec![camera], serial_ports: vec![port] }
    }

    #[test]
    fn the_list_is_told_in_words() {
        let expected = "\
camera /dev/v4l/by-path/a
  /dev/video0, Webcam (uvcvideo), USB bus 1, port 2.1, 480 Mbit/s
  also /dev/v4l/by-id/b
  YUYV  640x480  30, 15 frames a second
  gain = 7: 0 to 100, default 1, an automatic decides it now
  auto_exposure = \"Aperture\": \"Manual Mode\" | \"Aperture\", default \"Manual Mode\"
  auto_white = false: default true
serial port /dev/serial/by-id/arm
  /dev/ttyUSB0, FTDI arm
";
        assert_eq!(in_words(&devices()), expected);
        let none = in_words(&Devices { cameras: Vec::new(), serial_ports: Vec::new() });
        assert!(none.starts_with("no cameras: ") && none.contains("no serial ports: "), "{none}");
    }

    #[test]
    fn the_list_is_an_object_with_stable_names() {
        let json = serde_json::to_value(devices()).expect("json");
        let camera = &json["cameras"][0];
        assert_eq!(camera["device"], "/dev/v4l/by-path/a");
        assert_eq!(camera["card"], "Webcam");
        assert_eq!(camera["usb"]["bus"], 1);
        assert_eq!(camera["formats"][0]["sizes"][0]["rates_hz"][1], 15.0);
        assert_eq!(camera["controls"][0]["value"], 7);
        assert_eq!(camera["controls"][1]["menu"][0][1], "Manual Mode");
        assert_eq!(json["serial_ports"][0]["port"], "/dev/serial/by-id/arm");
    }
}
