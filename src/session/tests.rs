use std::collections::BTreeMap;
use std::io::Cursor;

use mcap::records::{MessageHeader, op};
use mcap::{Compression, WriteOptions};
use prost::Message;

use super::foxglove::{CompressedImage, RawImage, timestamp};
use super::*;
use crate::frame::PixelFormat;

const WALL_NS: i64 = 1_700_000_000_000_000_000;

fn jpeg() -> Vec<u8> {
    let mut bytes = Cursor::new(Vec::new());
    image::RgbImage::from_pixel(8, 8, image::Rgb([200, 2, 3]))
        .write_to(&mut bytes, image::ImageFormat::Jpeg)
        .unwrap();
    bytes.into_inner()
}

fn raw(encoding: &str, width: u32, height: u32, step: u32, data: Vec<u8>) -> Vec<u8> {
    let encoding = encoding.into();
    RawImage { width, height, encoding, step, data, ..Default::default() }.encode_to_vec()
}

/// A file that other programs could have written.
struct Foreign {
    writer: mcap::Writer<Cursor<Vec<u8>>>,
}

impl Foreign {
    fn new(compression: Option<Compression>) -> Self {
        let options = WriteOptions::new().compression(compression).chunk_size(Some(2000));
        Self { writer: options.create(Cursor::new(Vec::new())).unwrap() }
    }

    fn topic(&mut self, topic: &str, schema: &str, encoding: &str) -> u16 {
        let schema = self.writer.add_schema(schema, encoding, b"").unwrap();
        self.writer.add_channel(schema, topic, encoding, &BTreeMap::new()).unwrap()
    }

    fn message(&mut self, channel_id: u16, at_ns: i64, data: &[u8]) {
        let time = (WALL_NS + at_ns) as u64;
        let header = MessageHeader { channel_id, sequence: 0, log_time: time, publish_time: time };
        self.writer.write_to_known_channel(&header, data).unwrap();
    }

    fn bytes(mut self) -> Vec<u8> {
        self.writer.finish().unwrap();
        self.writer.into_inner().into_inner()
    }
}

/// Six pairs, 50 ms apart; the right picture of the third is missing.
fn six_pairs(compression: Option<Compression>) -> Vec<u8> {
    let mut file = Foreign::new(compression);
    let left = file.topic("/cell/Left", "foxglove.CompressedImage", "protobuf");
    let right = file.topic("/cell/right", "foxglove.RawImage", "protobuf");
    file.topic("/other", "std_msgs/String", "ros1msg");
    for i in 0..6 {
        let at_ns = i * 50_000_000;
        let stamp = Some(timestamp(WALL_NS + at_ns));
        let image =
            CompressedImage { timestamp: stamp, format: "jpeg".into(), data: jpeg(), ..Default::default() };
        // Logged long after the light was seen: the stamp counts.
        file.message(left, 7_000_000_000 - at_ns, &image.encode_to_vec());
        if i != 2 {
            file.message(right, at_ns + 3_000_000, &raw("mono8", 8, 8, 8, vec![i as u8; 64]));
        }
    }
    file.bytes()
}

fn write(folder: &Path, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

#[test]
fn a_recording_gives_its_pairs_by_their_time_stamps() {
    let folder = tempfile::tempdir().unwrap();
    for compression in [None, Some(Compression::Lz4), Some(Compression::Zstd)] {
        let session = Session::open(&write(folder.path(), "a.mcap", &six_pairs(compression))).unwrap();
        assert!((session.rate_hz - 20.0).abs() < 1e-6 && session.break_note().is_none());
        let there = |pair: &RecordedPair| pair.pictures.each_ref().map(Option::is_some);
        let pairs: Vec<_> = session.pairs.iter().map(|p| (&*p.name, there(p))).collect();
        assert_eq!((pairs.len(), pairs[0], pairs[2]), (6, ("000001", [true; 2]), ("000003", [true, false])));
        assert_eq!((session.pairs[0].after_ns, session.pairs[5].after_ns), (0, 250_000_000));
        let [Some(left), Some(right)] = &session.pairs[4].pictures else { panic!("both") };
        let left_frame = left.read().unwrap();
        assert_eq!((left_frame.format, left_frame.width), (PixelFormat::Mjpeg, 8));
        assert_eq!(left_frame.bytes, jpeg());
        assert_eq!(left.read_raw().unwrap().format, PixelFormat::Rgb);
        let right_frame = right.read().unwrap();
        assert_eq!((right_frame.format, &right_frame.bytes[..]), (PixelFormat::Grey, &[4; 64][..]));
        assert!(right.place().display().to_string().contains("a.mcap, /cell/right at byte "));
    }
}

#[test]
fn a_recording_that_breaks_off_is_read_up_to_there_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let whole = six_pairs(Some(Compression::Lz4));
    let mut lengths = Vec::new();
    for cut in (1000..whole.len()).step_by(97) {
        match Session::open(&write(folder.path(), "cut.mcap", &whole[..cut])) {
            Ok(session) => {
                lengths.push(session.pairs.len());
                assert!(session.break_note().unwrap().contains("cut.mcap: its end is missing"));
            }
            Err(e) => {
                let e = e.to_string();
                assert!(
                    e.contains("no pictures of two cameras") && e.contains("it breaks off at byte"),
                    "{e}"
                );
            }
        }
    }
    assert!(lengths.is_sorted() && lengths.last() == Some(&6), "{lengths:?}");
    let zeros = [&whole[..whole.len() - 60], &[0; 4096]].concat();
    let session = Session::open(&write(folder.path(), "zeros.mcap", &zeros)).unwrap();
    assert_eq!((session.pairs.len(), session.broken_at.is_some()), (6, true));
}

/// Where the last chunk stands, and the first byte behind it.
fn last_chunk(bytes: &[u8]) -> (usize, usize) {
    let (mut at, mut last) = (mcap::MAGIC.len(), None);
    while bytes[at] != op::DATA_END {
        let length = u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap());
        let after = at + 9 + length as usize;
        last = if bytes[at] == op::CHUNK { Some((at, after)) } else { last };
        at = after;
    }
    last.unwrap()
}

#[test]
fn a_chunk_whose_content_a_power_cut_has_lost_ends_the_recording() {
    let folder = tempfile::tempdir().unwrap();
    for compression in [None, Some(Compression::Lz4), Some(Compression::Zstd)] {
        let whole = six_pairs(compression);
        let (at, after) = last_chunk(&whole);
        for kept in [60, (after - at) / 2, after - at - 20] {
            let mut torn = whole[..after].to_vec();
            torn[at + kept..].fill(0);
            let session = Session::open(&write(folder.path(), "torn.mcap", &torn)).unwrap();
            assert_eq!(session.broken_at, Some(at as u64), "{compression:?}, {kept} bytes kept");
            let pictures = session.pairs.iter().flat_map(|pair| pair.pictures.iter().flatten()).count();
            assert!((2..11).contains(&pictures), "{pictures} of 11 pictures");
        }
    }
}

#[test]
fn a_chunk_that_states_more_than_it_could_become_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for compression in [Compression::Lz4, Compression::Zstd] {
        let mut bytes = six_pairs(Some(compression));
        let (at, _) = last_chunk(&bytes);
        // Behind opcode, length and two times.
        bytes[at + 25..at + 33].copy_from_slice(&(1_u64 << 30).to_le_bytes());
        let error = Session::open(&write(folder.path(), "big.mcap", &bytes)).unwrap_err().to_string();
        assert!(error.contains(&format!("damaged at byte {at}: a record of 1073741824 bytes")), "{error}");
    }
}

#[test]
fn a_recording_with_hours_between_its_pairs_is_played_within_seconds() {
    let folder = tempfile::tempdir().unwrap();
    let mut file = Foreign::new(None);
    let sides = ["/left", "/right"].map(|topic| file.topic(topic, "foxglove.RawImage", "protobuf"));
    for hour in 0..2 {
        for side in sides {
            file.message(side, hour * 3_600_000_000_000, &raw("mono8", 2, 2, 2, vec![0; 4]));
        }
    }
    let session = Session::open(&write(folder.path(), "hours.mcap", &file.bytes())).unwrap();
    assert_eq!((session.pairs.len(), session.period()), (2, Duration::from_secs(10)));
    assert_eq!(session.pairs[1].after_ns, 10_000_000_000);
}

#[test]
fn what_is_no_recording_is_named_with_its_place() {
    let folder = tempfile::tempdir().unwrap();
    let message =
        |name: &str, bytes: &[u8]| Session::open(&write(folder.path(), name, bytes)).unwrap_err().to_string();
    assert!(message("e.mcap", b"").ends_with("before its first second has nothing to show"));
    assert!(message("t.mcap", b"hello there, no recording").contains("t.mcap: not an MCAP file"));
    assert!(message("s.mcap", b"\x89MC").contains("not an MCAP file"));
    let mut whole = six_pairs(Some(Compression::Lz4));
    let middle = whole.len() / 3;
    whole[middle] ^= 0x55;
    let damaged = message("d.mcap", &whole);
    assert!(damaged.contains("d.mcap: damaged at byte ") && damaged.contains("fetch the file again"));
    let mut file = Foreign::new(None);
    let images = file.topic("/camera/image", "sensor_msgs/Image", "ros1");
    file.message(images, 0, b"x");
    let foreign = message("f.mcap", &file.bytes());
    assert!(foreign.ends_with("there are: /camera/image (sensor_msgs/Image, ros1)"), "{foreign}");
    let mut file = Foreign::new(None);
    let left = file.topic("/left", "foxglove.RawImage", "protobuf");
    file.message(left, 0, b"\xff\xff\xff");
    let broken = message("p.mcap", &file.bytes());
    assert!(
        broken.contains("the message on /left at byte ") && broken.contains("cannot be read"),
        "{broken}"
    );
}

#[test]
fn a_picture_of_a_recording_must_be_whole_and_in_a_format_of_cameras() {
    let place = || PathBuf::from("x");
    let read = |message: &[u8]| picture::from_message(message, ImageKind::Raw, Default::default(), place());
    for (encoding, step, bytes) in [("nv12", 4, 24), ("yuyv", 8, 32), ("rgb8", 13, 60), ("bgr8", 12, 48)] {
        let frame = read(&raw(encoding, 4, 4, step, vec![1; bytes])).unwrap();
        assert_eq!(frame.stride_bytes, step as usize, "{encoding}");
    }
    let message = |bytes: &[u8]| read(bytes).unwrap_err().to_string();
    assert!(message(&raw("32FC1", 4, 4, 16, vec![0; 64])).contains("encoding \"32FC1\"; possible are yuyv"));
    assert!(message(&raw("rgb8", 4, 4, 12, vec![0; 47])).contains("47 bytes with 12 a row for 4x4 pixels"));
    assert!(message(&raw("rgb8", 4, 4, 11, vec![0; 48])).contains("no whole picture"));
    assert!(message(&raw("mono8", 0, 4, 11, vec![0; 48])).contains("no whole picture"));
    assert!(message(&raw("mono8", 9000, 1, 9000, vec![])).contains("at most 8192 a side"));
}

proptest::proptest! {
    #![proptest_config(proptest::prelude::ProptestConfig { cases: 200, ..Default::default() })]
    /// Behind whatever checksums: pictures, results and words of the arm that are not what their schemas promise.
    #[test]
    fn no_message_makes_reader_or_copier_panic_or_hang(
        changes in proptest::collection::vec((0..4usize, 0.0..1.0f64, 0..9usize, ".{0,3}"), 1..8),
        seconds in (-1.0..2.0f64, -1.0..2.0f64),
    ) {
        use super::events::Topic;
        let stamp = Some(timestamp(WALL_NS));
        let pair = events::PairRecord {
            stamps_ns: [WALL_NS; 2], seed: Some(1), iterations: Some(2), name: "p".into(), ..Default::default()
        };
        let report = firmware_bridge::message::Report::Done { id: 1 };
        let mut messages = [
            CompressedImage { timestamp: stamp, format: "jpeg".into(), data: jpeg(), ..Default::default() }.encode_to_vec(),
            raw("mono8", 8, 8, 8, vec![1; 64]),
            serde_json::to_vec(&pair).unwrap(),
            serde_json::to_vec(&events::ReportRecord { report }).unwrap(),
        ];
        for (which, at, removed, put) in changes {
            let message = &mut messages[which];
            let at = (at * message.len() as f64) as usize;
            let end = (at + removed).min(message.len());
            message.splice(at..end, put.into_bytes());
        }
        let mut file = Foreign::new(Some(Compression::Lz4));
        let topics = [
            file.topic("/left", "foxglove.CompressedImage", "protobuf"),
            file.topic("/right", "foxglove.RawImage", "protobuf"),
            file.topic("/pair", Topic::Pair.schema_name(), "json"),
            file.topic("/arm/report", Topic::Report.schema_name(), "json"),
        ];
        for i in 0..4 {
            for (topic, message) in topics.into_iter().zip(&messages) {
                file.message(topic, i * 50_000_000, message);
            }
        }
        let folder = tempfile::tempdir().unwrap();
        let path = write(folder.path(), "x.mcap", &file.bytes());
        if let Ok(session) = Session::open(&path) {
            for picture in session.pairs.iter().flat_map(|pair| pair.pictures.iter().flatten()) {
                let _ = picture.read_raw();
            }
        }
        let _ = copy::cut(&path, seconds, &folder.path().join("piece.mcap"));
        let copied = copy::recover(&path, &folder.path().join("all.mcap")).unwrap();
        proptest::prop_assert_eq!(copied.messages, 16);
    }

    #[test]
    fn no_change_of_bytes_makes_the_reader_panic_or_hang(
        compression in 0..3usize,
        changes in proptest::collection::vec((0.0..1.0f64, proptest::prelude::any::<u8>()), 1..6),
    ) {
        let compression = [None, Some(Compression::Lz4), Some(Compression::Zstd)][compression];
        let mut bytes = six_pairs(compression);
        for (at, byte) in changes {
            let at = (at * bytes.len() as f64) as usize;
            bytes[at] = byte;
        }
        let folder = tempfile::tempdir().unwrap();
        if let Ok(session) = Session::open(&write(folder.path(), "x.mcap", &bytes)) {
            for picture in session.pairs.iter().flat_map(|pair| pair.pictures.iter().flatten()) {
                let _ = picture.read();
            }
        }
        let _ = copy::recover(&folder.path().join("x.mcap"), &folder.path().join("y.mcap"));
        let _ = copy::cut(&folder.path().join("x.mcap"), (0.0, 0.1), &folder.path().join("z.mcap"));
    }
}
