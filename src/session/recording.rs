//! A recording as a session: its picture messages, paired by their times.

use std::collections::{HashMap, HashSet};
use std::path::Path;
use std::sync::Arc;

use firmware_bridge::link::{Said, What};
use firmware_bridge::message::Report;
use mcap::records::Record;
use prost::Message;

use super::events::{CommandRecord, PairRecord, ReportRecord, Topic};
use super::foxglove::{self, CompressedImage, ImageKind, RawImage};
use super::records::{MessageAt, MessageError, RecordAt, RecordingError, RecordingFile};
use super::writer::{METADATA, PAIR_WINDOW};
use super::{Fate, RecordedPair, RecordedPicture, RecordedSearch, Results, Session};
use crate::camera::Side;
use crate::frame::{ColourEncoding, RATE_HZ, TimestampMark};
use crate::time::Spent;

/// Pairs a second, where a recording has one pair only.
const LONE_RATE_HZ: f64 = 30.0;

/// Longest pause between two pairs that is kept, ns: nobody waits for what a stopped clock or a foreign file says.
const PAUSE_NS_MAX: i64 = 10_000_000_000;

/// A picture and when its light was seen, ns since 1970.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    wall_ns: i64,
    pub(super) at: MessageAt,
    channel: u16,
}

/// What a channel carries.
#[derive(Clone, Debug)]
struct Channel {
    topic: Arc<str>,
    /// Name of the schema, and encoding of the messages.
    about: String,
    image: Option<ImageKind>,
    /// A topic of ours.
    record: Option<Topic>,
    encoding: ColourEncoding,
}

/// What is found while the records go by.
#[derive(Debug, Default)]
struct Index {
    schemas: HashMap<u16, String>,
    channels: HashMap<u16, Channel>,
    /// The topic of each side: the first that has a picture.
    topics: [Option<Arc<str>>; 2],
    pictures: [Vec<Seen>; 2],
    /// Names of pairs by the time stamps of their left pictures.
    names: HashMap<i64, String>,
    /// What is known of them, by the same.
    known: HashMap<i64, ([TimestampMark; 2], Fate)>,
    /// What cell and arm said to each other.
    arm: Vec<Said>,
    results: Results,
    /// The rate of the cell that was recorded, where the file says it.
    rate_hz: Option<f64>,
    /// How far apart the pictures of a pair may be, where the file says it, ns.
    window_ns: Option<i64>,
    /// Stamps of the left pictures of pairs that were recorded without a search.
    unsearched: Vec<i64>,
}

/// Pictures of one moment, and when the first of them was seen, ns since 1970.
pub(super) type Moment = (i64, [Option<Seen>; 2]);

/// When its pictures were seen, in order of time.
pub(super) fn moments(file: &RecordingFile) -> Result<Vec<Moment>, RecordingError> {
    Ok(index(file)?.1)
}

/// What is in a file, its pictures in pairs, the rate of their stamps, and where it breaks off.
fn index(file: &RecordingFile) -> Result<(Index, Vec<Moment>, f64, Option<u64>), RecordingError> {
    let mut index = Index::default();
    let broken_at = file.walk(|record| index.record(file, record))?;
    index.check_names();
    let [left, right] = &mut index.pictures;
    if left.is_empty() || right.is_empty() {
        let (path, topics) = (file.path().to_owned(), index.all_topics());
        return Err(RecordingError::NoPictures { path, topics, broken_at });
    }
    for side in [&mut *left, &mut *right] {
        side.sort_by_key(|seen| seen.wall_ns);
    }
    let period_ns = middle_period_ns(left);
    let seen_hz =
        period_ns.map_or(LONE_RATE_HZ, |ns| (1e9 / ns as f64).clamp(*RATE_HZ.start(), *RATE_HZ.end()));
    let pairs = pair_up(left, right, index.window_ns.unwrap_or(period_ns.unwrap_or(i64::MAX) / 2));
    // The pictures of a pair for which the recogniser had no time stand alone in the file.
    let there: HashSet<i64> = left.iter().map(|seen| seen.wall_ns).collect();
    let kept = index.unsearched.iter().filter(|stamp_ns| there.contains(stamp_ns)).count();
    index.results.without_pictures = index.results.without_pictures.saturating_sub(kept as u64);
    Ok((index, pairs, seen_hz, broken_at))
}

/// Reads through a recording.
pub(super) fn open(path: &Path) -> Result<Session, RecordingError> {
    let file = Arc::new(RecordingFile::open(path)?);
    let (index, pairs, seen_hz, broken_at) = index(&file)?;
    let rate_hz = index.rate_hz.unwrap_or(seen_hz);
    let mut after_ns = without_pauses(pairs.first().map_or(0, |(wall_ns, _)| *wall_ns));
    let picture = |seen: Seen| {
        let channel = &index.channels[&seen.channel];
        RecordedPicture::Message {
            file: Arc::clone(&file),
            topic: Arc::clone(&channel.topic),
            at: seen.at,
            kind: channel.image.unwrap_or(ImageKind::Raw),
            encoding: channel.encoding,
        }
    };
    let known = |pictures: &[Option<Seen>; 2]| pictures[0].and_then(|left| index.known.get(&left.wall_ns));
    let arm_lead_ns = arm_lead_ns(&index.arm, &pairs);
    // No name that another one has.
    let unnamed = if index.names.is_empty() { "" } else { "-unnamed" };
    let mut pair = |(i, (wall_ns, pictures)): (usize, Moment)| RecordedPair {
        name: pictures[0]
            .and_then(|left| index.names.get(&left.wall_ns).cloned())
            .unwrap_or_else(|| format!("{:06}{unnamed}", i + 1)),
        after_ns: after_ns(wall_ns),
        pictures: pictures.map(|seen| seen.map(picture)),
        marks: known(&pictures).map_or_else(Default::default, |known| known.0),
        fate: known(&pictures).map(|known| known.1),
    };
    let pairs = pairs.into_iter().enumerate().map(&mut pair).collect();
    Ok(Session {
        path: path.to_owned(),
        rate_hz,
        pairs,
        arm: index.arm,
        arm_lead_ns,
        results: index.results,
        broken_at,
    })
}

/// How long after the first of them moments are that come in order, with pauses cut short; ns.
fn without_pauses(first_ns: i64) -> impl FnMut(i64) -> i64 {
    let (mut after, mut previous_ns) = (0, first_ns);
    move |wall_ns| {
        after += wall_ns.saturating_sub(previous_ns).clamp(0, PAUSE_NS_MAX);
        previous_ns = wall_ns;
        after
    }
}

/// See [`Session::arm_lead_ns`].
fn arm_lead_ns(arm: &[Said], pairs: &[Moment]) -> Option<i64> {
    let (first_ns, first_word_ns) = (pairs.first()?.0, arm.first()?.at_ns);
    // In a piece of a recording the arm has connected long before.
    let connected_ns = match arm.iter().find(|said| matches!(said.what, What::Report(_))) {
        Some(Said { what: What::Report(Report::Connected { .. }), at_ns }) => *at_ns,
        _ => first_ns.min(first_word_ns),
    };
    if connected_ns <= first_ns {
        return Some(first_ns.saturating_sub(first_word_ns).clamp(0, PAUSE_NS_MAX));
    }
    let mut after_ns = without_pauses(first_ns);
    let before = pairs.iter().map(|pair| pair.0).take_while(|seen_ns| *seen_ns < connected_ns);
    before.chain([connected_ns]).map(&mut after_ns).last().map(|late_ns| -late_ns)
}

impl Index {
    fn record(
        &mut self,
        file: &RecordingFile,
        RecordAt { at, record }: RecordAt<'_>,
    ) -> Result<(), RecordingError> {
        match record {
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) => {
                let schema = self.schemas.get(&channel.schema_id).map_or("no schema", String::as_str);
                let is_record =
                    |topic: &Topic| topic.schema_name() == schema && channel.message_encoding == "json";
                let is_image =
                    |kind: &ImageKind| kind.schema_name() == schema && channel.message_encoding == "protobuf";
                let carried = Channel {
                    image: ImageKind::ALL.into_iter().find(is_image),
                    record: Topic::ALL.into_iter().find(is_record),
                    about: format!("{schema}, {}", channel.message_encoding),
                    encoding: foxglove::colour_of(&channel.metadata),
                    topic: channel.topic.into(),
                };
                self.channels.insert(channel.id, carried);
            }
            Record::Metadata(about) if about.name == METADATA => {
                let rate_hz = about.metadata.get("rate_hz").and_then(|text| text.parse().ok());
                self.rate_hz = rate_hz.filter(|hz: &f64| RATE_HZ.contains(hz));
                let window_ms = about.metadata.get(PAIR_WINDOW).and_then(|text| text.parse().ok());
                let window_ms = window_ms.filter(|ms: &f64| (0.0..=1e6).contains(ms));
                self.window_ns = window_ms.map(|ms| (ms * 1e6) as i64);
            }
            Record::Message { header, data } => {
                let Some(channel) = self.channels.get(&header.channel_id) else { return Ok(()) };
                let bad = |reason: MessageError| RecordingError::Message {
                    path: file.path().to_owned(),
                    topic: channel.topic.to_string(),
                    at_byte: at.byte,
                    reason,
                };
                if let (Some(kind), Some(side)) = (channel.image, side_of(&channel.topic)) {
                    let topic = self.topics[side.index()].get_or_insert_with(|| Arc::clone(&channel.topic));
                    if *topic != channel.topic {
                        return Ok(());
                    }
                    let stamp = stamp_of(kind, &data).map_err(bad)?;
                    let logged_ns = i64::try_from(header.log_time).unwrap_or(i64::MAX);
                    let wall_ns = stamp.unwrap_or(logged_ns);
                    self.pictures[side.index()].push(Seen { wall_ns, at, channel: header.channel_id });
                    return Ok(());
                }
                let at_ns = i64::try_from(header.log_time).unwrap_or(i64::MAX);
                match channel.record {
                    Some(Topic::Pair) => {
                        let pair: PairRecord = serde_json::from_slice(&data).map_err(|e| bad(e.into()))?;
                        self.results.add(&pair);
                        if !pair.pictures {
                            self.unsearched.push(pair.stamps_ns[0]);
                        }
                        self.known.insert(pair.stamps_ns[0], (pair.marks, fate(&pair, at_ns)));
                        self.names.insert(pair.stamps_ns[0], pair.name);
                    }
                    Some(Topic::Command) => {
                        let said: CommandRecord = serde_json::from_slice(&data).map_err(|e| bad(e.into()))?;
                        if said.refused.is_none() {
                            self.arm.push(Said { at_ns, what: What::Command(said.command) });
                        }
                    }
                    Some(Topic::Report) => {
                        let said: ReportRecord = serde_json::from_slice(&data).map_err(|e| bad(e.into()))?;
                        self.arm.push(Said { at_ns, what: What::Report(said.report) });
                    }
                    _ => {}
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// Pairs keep their names where these tell them apart and are fit to be names of files; else they are numbered.
    fn check_names(&mut self) {
        let is_fit = |name: &String| {
            let plain = name.chars().all(|c| c.is_ascii_alphanumeric() || matches!(c, '-' | '_'));
            plain && (1..=64).contains(&name.len())
        };
        let distinct: HashSet<&String> = self.names.values().collect();
        if distinct.len() < self.names.len() || !self.names.values().all(is_fit) {
            self.names.clear();
        }
    }

    /// For the message about what is missing.
    fn all_topics(&self) -> String {
        let mut topics: Vec<_> =
            self.channels.values().map(|c| format!("{} ({})", c.topic, c.about)).collect();
        topics.sort();
        topics.dedup();
        if topics.is_empty() { "none".into() } else { topics.join("; ") }
    }
}

/// What the cell did with a pair that it was finished with at `at_ns`.
fn fate(pair: &PairRecord, at_ns: i64) -> Fate {
    let search = pair.seed.zip(pair.iterations).map(|(seed, iterations)| {
        let &PairRecord { looks, exchanges, late, out_of_time, .. } = pair;
        RecordedSearch { seed, spent: Spent { iterations, looks, exchanges, late }, out_of_time }
    });
    if search.is_none() && pair.error.is_none() {
        return Fate::LeftOut;
    }
    let [left, right] = pair.stamps_ns;
    Fate::Searched { search, after_ns: at_ns.saturating_sub(left.min(right)).clamp(0, PAUSE_NS_MAX) }
}

/// The camera that a topic belongs to.
fn side_of(topic: &str) -> Option<Side> {
    let topic = topic.to_ascii_lowercase();
    let has = |side: &Side| topic.contains(side.name());
    match Side::BOTH.map(|side| has(&side)) {
        [true, false] => Some(Side::Left),
        [false, true] => Some(Side::Right),
        _ => None,
    }
}

/// The time stamp in a picture message.
fn stamp_of(kind: ImageKind, data: &[u8]) -> Result<Option<i64>, MessageError> {
    let stamp = match kind {
        ImageKind::Compressed => CompressedImage::decode(data)?.timestamp,
        ImageKind::Raw => RawImage::decode(data)?.timestamp,
    };
    Ok(stamp.as_ref().map(foxglove::wall_ns))
}

/// The middle one of the times from picture to picture; none where there are no two, or all have one time.
fn middle_period_ns(pictures: &[Seen]) -> Option<i64> {
    let mut periods: Vec<i64> =
        pictures.windows(2).map(|two| two[1].wall_ns.saturating_sub(two[0].wall_ns)).collect();
    periods.sort_unstable();
    periods.get(periods.len() / 2).copied().filter(|&ns| ns > 0)
}

/// Pictures of both sides that are at most `window_ns` apart, and those that are alone, in order of time.
fn pair_up(left: &[Seen], right: &[Seen], window_ns: i64) -> Vec<Moment> {
    let mut pairs = Vec::with_capacity(left.len());
    let (mut lefts, mut rights) = (left.iter().copied().peekable(), right.iter().copied().peekable());
    loop {
        let (l, r) = (lefts.peek().copied(), rights.peek().copied());
        let later_ns = match (l, r) {
            (Some(l), Some(r)) => r.wall_ns.saturating_sub(l.wall_ns),
            (Some(_), None) => i64::MAX,
            (None, Some(_)) => i64::MIN,
            (None, None) => return pairs,
        };
        let together = l.is_some() && r.is_some() && later_ns.saturating_abs() <= window_ns;
        let l = lefts.next_if(|_| together || later_ns > 0);
        let r = rights.next_if(|_| together || later_ns <= 0);
        let wall_ns = l.into_iter().chain(r).map(|seen| seen.wall_ns).min().unwrap_or(0);
        pairs.push((wall_ns, [l, r]));
    }
}

#[cfg(test)]
mod tests {
    use firmware_bridge::message::HeldBy;

    use super::*;

    #[test]
    fn an_arm_that_connected_after_the_first_picture_does_so_again() {
        const S: i64 = 1_000_000_000;
        let pairs = [10, 11, 12, 1000].map(|seen_s| (seen_s * S, [None; 2]));
        let lead_s = |said: &[(i64, Report)]| {
            let said: Vec<_> = said
                .iter()
                .map(|&(at_s, report)| Said { at_ns: at_s * S, what: What::Report(report) })
                .collect();
            arm_lead_ns(&said, &pairs).map(|ns| ns / S)
        };
        let connected = Report::Connected { session: 1, held_by: HeldBy::Start };
        assert_eq!(lead_s(&[(7, connected), (13, Report::ClearOfView)]), Some(3));
        assert_eq!(lead_s(&[(13, connected)]), Some(-3));
        // The pause before the last pair counts as the longest one.
        assert_eq!(lead_s(&[(1001, connected)]), Some(-13));
        // A piece that begins while the arm works.
        assert_eq!(lead_s(&[(13, Report::ClearOfView), (14, connected)]), Some(0));
        assert_eq!(lead_s(&[]), None);
    }
}
