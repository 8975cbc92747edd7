//! `[cameras]`: where the frame pairs come from, and how each camera is set.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

use serde::Deserialize;

use super::error::ConfigError;
use super::source::Source;
use crate::frame::{PixelFormat, QuantizationRange, RATE_HZ, SIDE_PX_MAX, YcbcrMatrix};

/// What delivers the frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Backend {
    /// Two cameras through Video4Linux.
    #[default]
    V4l2,
    /// A recorded session.
    Replay,
}

/// How fast a session is replayed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Pace {
    /// At the rate it was recorded with.
    #[default]
    Realtime,
    /// As fast as the cell takes the pairs.
    Fast,
}

/// What a camera control is set to.
#[derive(Clone, Debug, PartialEq)]
pub enum ControlValue {
    /// A number; for a menu its index, for an integer menu the value of the entry.
    Integer(i64),
    /// A switch.
    Boolean(bool),
    /// An entry of a menu by its name.
    Name(String),
}

/// One camera as it is to be opened. Nothing of it is negotiable: a camera that does not offer it is refused.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraSettings {
    /// Stable path of the device, under `/dev/v4l/by-path` or `/dev/v4l/by-id`.
    pub device: PathBuf,
    /// Pixel format.
    pub format: PixelFormat,
    /// Picture width in pixels.
    pub width: u32,
    /// Picture height in pixels.
    pub height: u32,
    /// Frames a second.
    pub rate_hz: f64,
    /// Colour matrix, where the camera's own word is not to be believed.
    pub matrix: Option<YcbcrMatrix>,
    /// Quantization range, where the camera's own word is not to be believed.
    pub range: Option<QuantizationRange>,
    /// Controls by name, set after every open.
    pub controls: BTreeMap<String, ControlValue>,
}

impl CameraSettings {
    /// Time from one frame to the next.
    pub fn period(&self) -> Duration {
        Duration::from_secs_f64(1.0 / self.rate_hz)
    }
}

/// `[cameras]`, checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Cameras {
    /// What delivers the frames.
    pub backend: Backend,
    /// The recorded session, a file or a folder. There where `backend` is [`Backend::Replay`].
    pub session: Option<PathBuf>,
    /// How fast it is replayed.
    pub pace: Pace,
    /// Two frames whose time stamps are further apart than this are no pair. `None`: 0.4 frame periods.
    pub pair_window: Option<Duration>,
    /// The left camera. There where `backend` is [`Backend::V4l2`].
    pub left: Option<CameraSettings>,
    /// The right camera. There where `backend` is [`Backend::V4l2`].
    pub right: Option<CameraSettings>,
}

impl Cameras {
    /// The pairing window for cameras with this frame period.
    pub fn pair_window(&self, period: Duration) -> Duration {
        self.pair_window.unwrap_or_else(|| period.mul_f64(0.4))
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Written {
    #[serde(default)]
    backend: Backend,
    session: Option<String>,
    #[serde(default)]
    pace: Pace,
    pair_window_ms: Option<f64>,
    left: Option<WrittenCamera>,
    right: Option<WrittenCamera>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct WrittenCamera {
    device: String,
    format: String,
    width: i64,
    height: i64,
    rate_hz: f64,
    matrix: Option<String>,
    range: Option<String>,
    #[serde(default)]
    controls: BTreeMap<String, toml::Value>,
}

impl Written {
    pub(super) fn check(self, source: &Source) -> Result<Cameras, ConfigError> {
        let camera = |side: &str, written: Option<WrittenCamera>| {
            written.map(|camera| camera.check(source, &format!("cameras.{side}"))).transpose()
        };
        let (left, right) = (camera("left", self.left)?, camera("right", self.right)?);
        let session = match (&self.session, self.backend) {
            (Some(written), Backend::Replay) => Some(source.existing("cameras.session", written)?),
            (Some(written), Backend::V4l2) => Some(source.resolve(written)),
            (None, Backend::V4l2) => None,
            (None, Backend::Replay) => {
                return Err(source.missing(
                    "cameras.session",
                    "backend = \"replay\" needs the recorded session: an .mcap file or a folder with left/, \
                     right/ and session.toml",
                ));
            }
        };
        if self.backend == Backend::V4l2 {
            for (side, there) in [("left", left.is_some()), ("right", right.is_some())] {
                if !there {
                    return Err(source.missing(
                        &format!("cameras.{side}"),
                        "backend = \"v4l2\" needs both cameras (device, format, width, height, rate_hz); \
                         `pickcell devices` lists what is there",
                    ));
                }
            }
        }
        if let (Some(left), Some(right)) = (&left, &right) {
            check_twins(source, left, right)?;
        }
        let pair_window = self.pair_window_ms.map(|ms| {
            // The rate of a session is known when that is open: `Cell::check_pair_window`.
            let camera = left.as_ref().filter(|_| self.backend == Backend::V4l2);
            let period_ms = camera.map_or(1000.0, |camera| camera.period().as_secs_f64() * 1e3);
            if ms.is_finite() && ms > 0.0 && ms <= period_ms / 2.0 {
                return Ok(Duration::from_secs_f64(ms / 1e3));
            }
            Err(refused_window(source, ms, period_ms))
        });
        Ok(Cameras {
            backend: self.backend,
            session,
            pace: self.pace,
            pair_window: pair_window.transpose()?,
            left,
            right,
        })
    }
}

pub(super) fn refused_window(source: &Source, window_ms: f64, period_ms: f64) -> ConfigError {
    let allowed = format!("milliseconds above 0, at most half a frame period ({:.2})", period_ms / 2.0);
    source.refuse("cameras.pair_window_ms", window_ms, allowed)
}

fn check_twins(source: &Source, left: &CameraSettings, right: &CameraSettings) -> Result<(), ConfigError> {
    if left.device == right.device {
        let device = format!("{:?}", right.device.display().to_string());
        return Err(source.refuse(
            "cameras.right.device",
            device,
            "another device than that of cameras.left",
        ));
    }
    if (left.width, left.height) != (right.width, right.height) {
        let allowed = format!("the size of cameras.left, {}x{}", left.width, left.height);
        let (key, value) = match left.width == right.width {
            true => ("cameras.right.height", right.height),
            false => ("cameras.right.width", right.width),
        };
        return Err(source.refuse(key, value, allowed));
    }
    if (left.rate_hz - right.rate_hz).abs() > 1e-3 {
        let allowed = format!("the rate of cameras.left, {}; pairs need one rate", left.rate_hz);
        return Err(source.refuse("cameras.right.rate_hz", right.rate_hz, allowed));
    }
    Ok(())
}

impl WrittenCamera {
    fn check(self, source: &Source, table: &str) -> Result<CameraSettings, ConfigError> {
        let key = |name: &str| format!("{table}.{name}");
        if self.device.trim().is_empty() {
            return Err(source.refuse(
                &key("device"),
                "\"\"",
                "a path under /dev/v4l/by-path or /dev/v4l/by-id",
            ));
        }
        let format = pixel_format(&self.format).ok_or_else(|| {
            let allowed = "\"YUYV\", \"MJPG\", \"GREY\", \"RGB3\", \"BGR3\", \"NV12\"";
            source.refuse(&key("format"), format!("{:?}", self.format), allowed)
        })?;
        let pixels = |name: &str, side: i64| {
            let allowed = format!("an even number of pixels from 2 to {SIDE_PX_MAX}");
            match side % 2 {
                0 => source.whole(&key(name), side, 2..=i64::from(SIDE_PX_MAX), &allowed),
                _ => Err(source.refuse(&key(name), side, allowed)),
            }
        };
        let (width, height) = (pixels("width", self.width)?, pixels("height", self.height)?);
        if !RATE_HZ.contains(&self.rate_hz) {
            let allowed = format!("frames a second from {} to {}", RATE_HZ.start(), RATE_HZ.end());
            return Err(source.refuse(&key("rate_hz"), self.rate_hz, allowed));
        }
        let matrix = match self.matrix.as_deref() {
            None => None,
            Some("bt601") => Some(YcbcrMatrix::Bt601),
            Some("bt709") => Some(YcbcrMatrix::Bt709),
            Some(other) => {
                return Err(source.refuse(&key("matrix"), format!("{other:?}"), "\"bt601\", \"bt709\""));
            }
        };
        let range = match self.range.as_deref() {
            None => None,
            Some("limited") => Some(QuantizationRange::Limited),
            Some("full") => Some(QuantizationRange::Full),
            Some(other) => {
                return Err(source.refuse(&key("range"), format!("{other:?}"), "\"limited\", \"full\""));
            }
        };
        let mut controls = BTreeMap::new();
        for (name, value) in self.controls {
            let value = match value {
                toml::Value::Integer(number) => ControlValue::Integer(number),
                toml::Value::Boolean(on) => ControlValue::Boolean(on),
                toml::Value::String(entry) => ControlValue::Name(entry),
                other => {
                    let allowed = "a whole number, true or false, or the name of a menu entry";
                    return Err(source.refuse(&key(&format!("controls.{name}")), other, allowed));
                }
            };
            controls.insert(name, value);
        }
        Ok(CameraSettings {
            device: source.resolve(&self.device),
            format,
            width,
            height,
            rate_hz: self.rate_hz,
            matrix,
            range,
            controls,
        })
    }
}

/// The pixel format of a V4L2 four-character code.
fn pixel_format(code: &str) -> Option<PixelFormat> {
    Some(match code {
        "RGB3" => PixelFormat::Rgb,
        "BGR3" => PixelFormat::Bgr,
        "GREY" => PixelFormat::Grey,
        "YUYV" => PixelFormat::Yuyv,
        "NV12" => PixelFormat::Nv12,
        "MJPG" => PixelFormat::Mjpeg,
        _ => return None,
    })
}
