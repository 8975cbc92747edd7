//! `[recognition]`: what is looked for, and how.

use std::path::PathBuf;

use serde::Deserialize;

use super::error::ConfigError;
use super::source::Source;
use crate::frame::SIDE_PX_MAX;
use crate::matching::{gate, search};
use crate::vision::binarize::ColourRange;
use crate::vision::thin::Algorithm;

/// No speck is larger than a picture.
const SPECK_PX_MAX: i64 = (SIDE_PX_MAX as i64).pow(2);

#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum WrittenThin {
    #[default]
    ZhangSuen,
    GuoHall,
}

/// Which search.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SearchMethod {
    /// The exhaustive one where its tree is small enough, Harmony Search beyond.
    #[default]
    Auto,
    /// Harmony Search.
    Harmony,
    /// Harmony Search with rates that change with time.
    Improved,
    /// Harmony Search with rates taken from its memory.
    SelfAdaptive,
    /// Random search.
    Random,
    /// Exhaustive search with branch and bound.
    Exhaustive,
}

/// Which nodes of the right picture may go with a node of the left one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Gate {
    /// Those that can be the same point.
    #[default]
    Epipolar,
    /// All.
    None,
}

impl From<SearchMethod> for search::Method {
    fn from(method: SearchMethod) -> Self {
        match method {
            SearchMethod::Auto => Self::Auto,
            SearchMethod::Harmony => Self::Harmony,
            SearchMethod::Improved => Self::Improved,
            SearchMethod::SelfAdaptive => Self::SelfAdaptive,
            SearchMethod::Random => Self::Random,
            SearchMethod::Exhaustive => Self::Exhaustive,
        }
    }
}

impl From<Gate> for gate::Mode {
    fn from(gate: Gate) -> Self {
        match gate {
            Gate::Epipolar => Self::Epipolar,
            Gate::None => Self::None,
        }
    }
}

/// Parameters of the Harmony Searches; the paper's names and, where it gives them, its values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Harmony {
    /// Harmonies in the memory (HMS).
    pub hms: usize,
    /// Rate of taking a value from the memory (HMCR), 0 to 1.
    pub hmcr: f64,
    /// Rate of moving such a value to a neighbour (PAR), 0 to 1.
    pub par: f64,
    /// Smallest PAR of the improved and the self-adaptive search.
    pub par_min: f64,
    /// Largest PAR of the improved and the self-adaptive search.
    pub par_max: f64,
}

/// `[recognition]`, checked. Relative paths are already resolved.
#[derive(Clone, Debug, PartialEq)]
pub struct Recognition {
    /// Part files, at least one.
    pub parts: Vec<PathBuf>,
    /// Which pixels are part.
    pub colour: ColourRange,
    /// The parts are the pixels outside the range; with a threshold that is found: they are dark, on a light floor.
    pub inverted: bool,
    /// Corners of the region of interest in the left picture; empty: all of it.
    pub region_left_px: Vec<[f64; 2]>,
    /// Corners of the region of interest in the right picture; empty: all of it.
    pub region_right_px: Vec<[f64; 2]>,
    /// Connected specks with fewer pixels are dropped.
    pub min_speck_px: u32,
    /// Which thinning.
    pub thin: Algorithm,
    /// Which search.
    pub search: SearchMethod,
    /// Its parameters.
    pub harmony: Harmony,
    /// Which nodes may go together.
    pub gate: Gate,
    /// Seed of all randomness.
    pub seed: u64,
    /// A budget in iterations instead of the time that the deadline leaves.
    pub iterations: Option<u64>,
    /// What has this fitness or more is no part. `None`: the recogniser's own threshold.
    pub fitness_max: Option<f64>,
    /// Threads that the two pictures of a pair are shared by, 1 or 2.
    pub threads: u8,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Written {
    parts: Vec<String>,
    colour: Option<toml::Value>,
    #[serde(default)]
    inverted: bool,
    region_px: Option<toml::Value>,
    min_speck_px: Option<i64>,
    #[serde(default)]
    thin: WrittenThin,
    #[serde(default)]
    search: SearchMethod,
    hms: Option<i64>,
    hmcr: Option<f64>,
    par: Option<f64>,
    par_min: Option<f64>,
    par_max: Option<f64>,
    #[serde(default)]
    gate: Gate,
    seed: Option<u64>,
    iterations: Option<i64>,
    fitness_max: Option<f64>,
    threads: Option<i64>,
}

impl Written {
    pub(super) fn check(self, source: &Source) -> Result<Recognition, ConfigError> {
        if self.parts.is_empty() {
            return Err(source.refuse(
                "recognition.parts",
                "[]",
                "at least one part file, [\"rod-90.toml\"]",
            ));
        }
        let mut parts = Vec::with_capacity(self.parts.len());
        for written in &self.parts {
            let path = source.existing("recognition.parts", written)?;
            if parts.contains(&path) {
                return Err(source.refuse(
                    "recognition.parts",
                    format!("{written:?}"),
                    "every part file once",
                ));
            }
            parts.push(path);
        }
        let harmony = self.harmony(source)?;
        let colour = self.colour.map_or(Ok(ColourRange::Auto), |value| colour(source, &value))?;
        let (region_left_px, region_right_px) =
            self.region_px.map_or(Ok((Vec::new(), Vec::new())), |value| region(source, &value))?;
        let above_zero = |key: &str, value: f64| match value.is_finite() && value > 0.0 {
            true => Ok(value),
            false => Err(source.refuse(key, value, "a number above 0")),
        };
        let fitness_max = self.fitness_max.map(|f| above_zero("recognition.fitness_max", f)).transpose()?;
        let iterations = self.iterations.map(|iterations| {
            source.whole("recognition.iterations", iterations, 1..=i64::MAX, "a whole number from 1")
        });
        Ok(Recognition {
            parts,
            colour,
            inverted: self.inverted,
            region_left_px,
            region_right_px,
            min_speck_px: source.whole(
                "recognition.min_speck_px",
                self.min_speck_px.unwrap_or(20),
                0..=SPECK_PX_MAX,
                &format!("a number of pixels from 0 to {SPECK_PX_MAX}"),
            )?,
            thin: match self.thin {
                WrittenThin::ZhangSuen => Algorithm::ZhangSuen,
                WrittenThin::GuoHall => Algorithm::GuoHall,
            },
            search: self.search,
            harmony,
            gate: self.gate,
            seed: self.seed.unwrap_or(1),
            iterations: iterations.transpose()?,
            fitness_max,
            threads: source.whole("recognition.threads", self.threads.unwrap_or(1), 1..=2, "1 or 2")?,
        })
    }

    fn harmony(&self, source: &Source) -> Result<Harmony, ConfigError> {
        let share = |name: &str, value: Option<f64>, default: f64| match value {
            None => Ok(default),
            Some(rate) if rate.is_finite() && (0.0..=1.0).contains(&rate) => Ok(rate),
            Some(rate) => {
                Err(source.refuse(&format!("recognition.{name}"), rate, "a rate from 0 to 1, without unit"))
            }
        };
        let hms_allowed = "2 to 1000 harmonies (the paper: 20 to 70)";
        let harmony = Harmony {
            hms: source.whole("recognition.hms", self.hms.unwrap_or(20), 2..=1000, hms_allowed)?,
            hmcr: share("hmcr", self.hmcr, 0.7)?,
            par: share("par", self.par, 0.3)?,
            par_min: share("par_min", self.par_min, 0.1)?,
            par_max: share("par_max", self.par_max, 0.5)?,
        };
        if harmony.par_min > harmony.par_max {
            let allowed = format!("at most par_max = {}", harmony.par_max);
            return Err(source.refuse("recognition.par_min", harmony.par_min, allowed));
        }
        Ok(harmony)
    }
}

const COLOUR: &str = "\"auto\", { min = [r, g, b], max = [r, g, b] } or { grey_min = n, grey_max = n }, \
                      each number from 0 to 255, no minimum above its maximum";

fn colour(source: &Source, value: &toml::Value) -> Result<ColourRange, ConfigError> {
    let refuse = || source.refuse("recognition.colour", value, COLOUR);
    if value.as_str() == Some("auto") {
        return Ok(ColourRange::Auto);
    }
    let table = value.as_table().filter(|table| table.len() == 2).ok_or_else(refuse)?;
    let byte = |value: &toml::Value| value.as_integer().and_then(|n| u8::try_from(n).ok());
    let corner = |key: &str| -> Option<[u8; 3]> {
        let bytes: Option<Vec<u8>> = table.get(key)?.as_array()?.iter().map(byte).collect();
        bytes?.try_into().ok()
    };
    if let (Some(min), Some(max)) = (corner("min"), corner("max"))
        && min.iter().zip(&max).all(|(min, max)| min <= max)
    {
        return Ok(ColourRange::Rgb { min, max });
    }
    let grey = |key: &str| table.get(key).and_then(byte);
    match (grey("grey_min"), grey("grey_max")) {
        (Some(min), Some(max)) if min <= max => Ok(ColourRange::Grey { min, max }),
        _ => Err(refuse()),
    }
}

type Polygon = Vec<[f64; 2]>;

fn region(source: &Source, value: &toml::Value) -> Result<(Polygon, Polygon), ConfigError> {
    let refuse = || {
        let allowed = "a polygon [[x, y], [x, y], [x, y], …] of at least three corners in pixels for both \
                       pictures, or { left = [[x, y], …], right = [[x, y], …] }";
        source.refuse("recognition.region_px", value, allowed)
    };
    match value {
        toml::Value::Array(_) => {
            let both = polygon(value).ok_or_else(refuse)?;
            Ok((both.clone(), both))
        }
        toml::Value::Table(sides) if sides.keys().all(|key| key == "left" || key == "right") => {
            let side = |key: &str| sides.get(key).map_or(Some(Vec::new()), polygon).ok_or_else(refuse);
            Ok((side("left")?, side("right")?))
        }
        _ => Err(refuse()),
    }
}

fn polygon(value: &toml::Value) -> Option<Polygon> {
    let corners: Option<Polygon> = value.as_array()?.iter().map(point).collect();
    corners.filter(|corners| corners.len() >= 3)
}

fn point(value: &toml::Value) -> Option<[f64; 2]> {
    let number = |value: &toml::Value| {
        value.as_float().or_else(|| value.as_integer().map(|n| n as f64)).filter(|n| n.is_finite())
    };
    match value.as_array()?.as_slice() {
        [x, y] => Some([number(x)?, number(y)?]),
        _ => None,
    }
}
