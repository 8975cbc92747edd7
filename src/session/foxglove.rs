//! The messages of a recording that Foxglove knows by name, as protobuf.
//!
//! Field numbers and encodings are those of Foxglove's published schemas. Pictures are protobuf, because bytes are
//! bytes there (JSON would carry them as base64, a third larger and in need of decoding).

use std::collections::BTreeMap;

use prost::Message;
use prost_types::field_descriptor_proto::{Label, Type};
use prost_types::{DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet, Timestamp};

use crate::frame::{ColourEncoding, PixelFormat, QuantizationRange, YcbcrMatrix};

/// A picture that is compressed, `foxglove.CompressedImage`.
#[derive(Clone, PartialEq, Message)]
pub struct CompressedImage {
    /// When the light was seen.
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    /// `left` or `right`.
    #[prost(string, tag = "4")]
    pub frame_id: String,
    /// The file.
    #[prost(bytes = "vec", tag = "2")]
    pub data: Vec<u8>,
    /// `jpeg` or `png`.
    #[prost(string, tag = "3")]
    pub format: String,
}

/// A picture without compression, `foxglove.RawImage`.
#[derive(Clone, PartialEq, Message)]
pub struct RawImage {
    /// When the light was seen.
    #[prost(message, optional, tag = "1")]
    pub timestamp: Option<Timestamp>,
    /// `left` or `right`.
    #[prost(string, tag = "7")]
    pub frame_id: String,
    /// Pixels.
    #[prost(fixed32, tag = "2")]
    pub width: u32,
    /// Pixels.
    #[prost(fixed32, tag = "3")]
    pub height: u32,
    /// How to read the bytes, see [`encoding_name`].
    #[prost(string, tag = "4")]
    pub encoding: String,
    /// From row to row, bytes.
    #[prost(fixed32, tag = "5")]
    pub step: u32,
    /// The rows.
    #[prost(bytes = "vec", tag = "6")]
    pub data: Vec<u8>,
}

/// Which of the two.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageKind {
    /// [`CompressedImage`].
    Compressed,
    /// [`RawImage`].
    Raw,
}

impl ImageKind {
    /// Both.
    pub const ALL: [ImageKind; 2] = [ImageKind::Compressed, ImageKind::Raw];

    /// What frames of this format are written as.
    pub fn of(format: PixelFormat) -> Self {
        if format == PixelFormat::Mjpeg { ImageKind::Compressed } else { ImageKind::Raw }
    }

    /// The name by which Foxglove knows the schema.
    pub fn schema_name(self) -> &'static str {
        match self {
            ImageKind::Compressed => "foxglove.CompressedImage",
            ImageKind::Raw => "foxglove.RawImage",
        }
    }

    /// The schema: a serialized `FileDescriptorSet` with all that it needs.
    pub fn schema(self) -> Vec<u8> {
        let time = |number| Field { name: "timestamp", number, kind: Type::Message };
        let field = |name, number, kind| Field { name, number, kind };
        let fields = match self {
            ImageKind::Compressed => vec![
                time(1),
                field("frame_id", 4, Type::String),
                field("data", 2, Type::Bytes),
                field("format", 3, Type::String),
            ],
            ImageKind::Raw => vec![
                time(1),
                field("frame_id", 7, Type::String),
                field("width", 2, Type::Fixed32),
                field("height", 3, Type::Fixed32),
                field("encoding", 4, Type::String),
                field("step", 5, Type::Fixed32),
                field("data", 6, Type::Bytes),
            ],
        };
        let own = self.schema_name().trim_start_matches("foxglove.");
        let file = proto("foxglove", own, fields);
        FileDescriptorSet { file: vec![timestamp_proto(), file] }.encode_to_vec()
    }
}

struct Field {
    name: &'static str,
    number: i32,
    kind: Type,
}

const TIMESTAMP_PROTO: &str = "google/protobuf/timestamp.proto";

fn timestamp_proto() -> FileDescriptorProto {
    let field = |name, number, kind| Field { name, number, kind };
    let fields = vec![field("seconds", 1, Type::Int64), field("nanos", 2, Type::Int32)];
    FileDescriptorProto {
        name: Some(TIMESTAMP_PROTO.into()),
        dependency: Vec::new(),
        ..proto("google.protobuf", "Timestamp", fields)
    }
}

/// A file with one message.
fn proto(package: &str, message: &str, fields: Vec<Field>) -> FileDescriptorProto {
    let field = |field: Field| FieldDescriptorProto {
        name: Some(field.name.into()),
        number: Some(field.number),
        label: Some(Label::Optional.into()),
        r#type: Some(field.kind.into()),
        type_name: (field.kind == Type::Message).then(|| ".google.protobuf.Timestamp".into()),
        ..Default::default()
    };
    FileDescriptorProto {
        name: Some(format!("{package}/{message}.proto")),
        package: Some(package.into()),
        dependency: vec![TIMESTAMP_PROTO.into()],
        message_type: vec![DescriptorProto {
            name: Some(message.into()),
            field: fields.into_iter().map(field).collect(),
            ..Default::default()
        }],
        syntax: Some("proto3".into()),
        ..Default::default()
    }
}

/// The name of a format's encoding in [`RawImage`]; none for MJPEG, which is a [`CompressedImage`].
pub fn encoding_name(format: PixelFormat) -> Option<&'static str> {
    Some(match format {
        PixelFormat::Rgb => "rgb8",
        PixelFormat::Bgr => "bgr8",
        PixelFormat::Grey => "mono8",
        PixelFormat::Yuyv => "yuyv",
        PixelFormat::Nv12 => "nv12",
        PixelFormat::Mjpeg => return None,
    })
}

/// The format that an encoding's name stands for.
pub fn format_of(encoding: &str) -> Option<PixelFormat> {
    Some(match encoding {
        "rgb8" => PixelFormat::Rgb,
        "bgr8" | "8UC3" => PixelFormat::Bgr,
        "mono8" | "8UC1" => PixelFormat::Grey,
        "yuyv" | "yuv422_yuy2" => PixelFormat::Yuyv,
        "nv12" => PixelFormat::Nv12,
        _ => return None,
    })
}

/// What Foxglove's schemas have no field for goes into the metadata of a picture's channel.
pub fn colour_metadata(encoding: ColourEncoding) -> BTreeMap<String, String> {
    let matrix = match encoding.matrix {
        YcbcrMatrix::Bt601 => "bt601",
        YcbcrMatrix::Bt709 => "bt709",
    };
    let range = match encoding.range {
        QuantizationRange::Limited => "limited",
        QuantizationRange::Full => "full",
    };
    BTreeMap::from([("matrix".into(), matrix.into()), ("range".into(), range.into())])
}

/// Reads what [`colour_metadata`] wrote; BT.601 limited where nothing is said.
pub fn colour_of(metadata: &BTreeMap<String, String>) -> ColourEncoding {
    let is = |key: &str, value: &str| metadata.get(key).is_some_and(|written| written == value);
    ColourEncoding {
        matrix: if is("matrix", "bt709") { YcbcrMatrix::Bt709 } else { YcbcrMatrix::Bt601 },
        range: if is("range", "full") { QuantizationRange::Full } else { QuantizationRange::Limited },
    }
}

/// Wall time, ns since 1970, as protobuf has it.
pub fn timestamp(wall_ns: i64) -> Timestamp {
    Timestamp { seconds: wall_ns.div_euclid(1_000_000_000), nanos: wall_ns.rem_euclid(1_000_000_000) as i32 }
}

/// The same back.
pub fn wall_ns(timestamp: &Timestamp) -> i64 {
    timestamp.seconds.saturating_mul(1_000_000_000).saturating_add(i64::from(timestamp.nanos))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_schema_is_a_set_of_files_with_its_message_last() {
        for kind in ImageKind::ALL {
            let set = FileDescriptorSet::decode(&*kind.schema()).unwrap();
            let [time, own] = &set.file[..] else { panic!("two files") };
            assert_eq!((time.name(), time.dependency.len()), (TIMESTAMP_PROTO, 0));
            let message = &own.message_type[0];
            assert_eq!(format!("{}.{}", own.package(), message.name()), kind.schema_name());
            assert!(message.field.iter().any(|field| field.type_name() == ".google.protobuf.Timestamp"));
        }
    }

    #[test]
    fn names_of_encodings_and_colours_come_back() {
        use PixelFormat::{Bgr, Grey, Nv12, Rgb, Yuyv};
        for format in [Rgb, Bgr, Grey, Yuyv, Nv12] {
            assert_eq!(encoding_name(format).and_then(format_of), Some(format));
        }
        assert_eq!((encoding_name(PixelFormat::Mjpeg), format_of("32FC1")), (None, None));
        let encoding = ColourEncoding { matrix: YcbcrMatrix::Bt709, range: QuantizationRange::Full };
        assert_eq!(colour_of(&colour_metadata(encoding)), encoding);
        assert_eq!(colour_of(&BTreeMap::new()), ColourEncoding::default());
        for ns in [0, -1, 1_700_000_000_123_456_789] {
            assert_eq!(wall_ns(&timestamp(ns)), ns);
        }
    }
}
