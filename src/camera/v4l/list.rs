//! The cameras of this machine: their nodes, stable paths, USB buses, and what each offers.

use std::fs;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::device::{ControlInfo, Device, Identity};
use super::format::{self, OfferedFormat};

/// Where udev puts links that stay the same when numbers change, best first: those of the project's own rule, then
/// the port, then the serial number, which two webcams of one make may share.
const STABLE: [&str; 3] = ["/dev/pickcell", "/dev/v4l/by-path", "/dev/v4l/by-id"];

/// A camera that is plugged in.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Listed {
    /// The path to write into cell.toml: a stable one where there is one.
    pub device: PathBuf,
    /// The kernel's node.
    pub node: PathBuf,
    /// Links to that node that stay the same.
    pub stable_paths: Vec<PathBuf>,
    /// Who it says it is; `None` where it cannot be opened.
    #[serde(flatten)]
    pub identity: Option<Identity>,
    /// Where it hangs, for USB cameras.
    pub usb: Option<UsbPort>,
    /// Formats, sizes and rates.
    pub formats: Vec<OfferedFormat>,
    /// Controls and their present values.
    pub controls: Vec<ListedControl>,
    /// Why there is nothing more to say.
    pub problem: Option<String>,
}

/// A control with its present value.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ListedControl {
    /// The control.
    #[serde(flatten)]
    pub info: ControlInfo,
    /// Its value; `None` where it has none.
    pub value: Option<i64>,
}

/// Where a USB device is plugged in.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct UsbPort {
    /// Number of the bus; cameras of one bus share its bandwidth.
    pub bus: u32,
    /// Port on that bus, hubs included.
    pub port: String,
    /// Speed of the device, Mbit/s.
    pub speed_mbit_s: f64,
}

/// All nodes that deliver pictures, in the order of their numbers.
pub fn cameras() -> Vec<Listed> {
    let mut numbers: Vec<u32> = names("/sys/class/video4linux", "video");
    if numbers.is_empty() {
        numbers = names("/dev", "video");
    }
    numbers.sort_unstable();
    numbers.iter().filter_map(|number| listed(&PathBuf::from(format!("/dev/video{number}")))).collect()
}

fn names(folder: &str, prefix: &str) -> Vec<u32> {
    let Ok(entries) = fs::read_dir(folder) else { return Vec::new() };
    let number = |name: &str| name.strip_prefix(prefix)?.parse().ok();
    entries.flatten().filter_map(|entry| number(entry.file_name().to_str()?)).collect()
}

/// `None` for nodes that deliver no pictures, such as the metadata nodes of USB cameras.
fn listed(node: &Path) -> Option<Listed> {
    let stable_paths = stable_paths(node);
    let mut listed = Listed {
        device: stable_paths.first().cloned().unwrap_or_else(|| node.to_path_buf()),
        node: node.to_path_buf(),
        stable_paths,
        identity: None,
        usb: usb_port(node),
        formats: Vec::new(),
        controls: Vec::new(),
        problem: None,
    };
    match Device::open(node).and_then(|device| device.identity().map(|identity| (device, identity))) {
        Ok((_, identity)) if !identity.captures => return None,
        Ok((device, identity)) => {
            listed.formats = format::offered(&device);
            let controls = device.controls().into_iter();
            let valued =
                |info: ControlInfo| ListedControl { value: device.value(&info).ok().flatten(), info };
            listed.controls = controls.map(valued).collect();
            listed.identity = Some(identity);
        }
        Err(error) => listed.problem = Some(problem(&error)),
    }
    Some(listed)
}

fn problem(error: &std::io::Error) -> String {
    match error.raw_os_error() {
        Some(libc::EACCES | libc::EPERM) => {
            "no right to open it; add the user to the group video and log in again".to_owned()
        }
        Some(libc::EBUSY) => "another program has it; end that one".to_owned(),
        _ => format!("cannot be opened: {error}"),
    }
}

/// Links to a node: those of udev, then any other directly in /dev, as udev rules of one's own make them.
pub fn stable_paths(node: &Path) -> Vec<PathBuf> {
    let Ok(real) = fs::canonicalize(node) else { return Vec::new() };
    let mut found = Vec::new();
    for folder in STABLE.iter().copied().chain(["/dev"]) {
        let Ok(entries) = fs::read_dir(folder) else { continue };
        let links = entries.flatten().filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_symlink()));
        let mut links: Vec<PathBuf> = links.map(|entry| entry.path()).collect();
        links.retain(|link| fs::canonicalize(link).is_ok_and(|target| target == real));
        links.sort();
        found.extend(links);
    }
    found
}

/// What to write in place of a path that is a number of the kernel's, which changes when cameras are plugged in anew;
/// `None` where the path is none.
pub fn better_path(device: &Path) -> Option<String> {
    let is_number = device.to_str().is_some_and(|path| path.starts_with("/dev/video"));
    let stable = || stable_paths(device).first().map(|path| path.display().to_string());
    is_number.then(|| stable().unwrap_or_else(|| "a path under /dev/v4l/by-path".into()))
}

/// Where the device of a node hangs on USB.
pub fn usb_port(node: &Path) -> Option<UsbPort> {
    let real = fs::canonicalize(node).ok()?;
    let name = real.file_name()?;
    let device = fs::canonicalize(Path::new("/sys/class/video4linux").join(name).join("device")).ok()?;
    let usb = device.ancestors().find(|folder| folder.join("busnum").is_file())?;
    let read = |file: &str| fs::read_to_string(usb.join(file)).ok().map(|text| text.trim().to_owned());
    Some(UsbPort {
        bus: read("busnum")?.parse().ok()?,
        port: read("devpath")?,
        speed_mbit_s: read("speed")?.parse().ok()?,
    })
}
