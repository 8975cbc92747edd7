//! Packets of PickCell's own protocol: messages ↔ bytes. `no_std`, without memory of its own but the decoder's
//! buffer; a firmware can use it as it is. PROTOCOL.md says the same byte by byte, with test vectors.
//!
//! Takes [`ToArm`] and [`FromArm`], gives packets, and back. Owns the version byte, the checksum and the framing,
//! not the conversation: who sends what when is `dialect::own` and, on the arm's side, `simulate::own`.
//!
//! ```
//! use firmware_bridge::codec::{self, Decoder, ToArm, ToArmBody};
//! let hold = ToArm { sequence: 5, body: ToArmBody::Hold };
//! let mut packet = [0; codec::PACKET_LEN_MAX];
//! let len = codec::encode(&hold, &mut packet).unwrap();
//! let mut decoder = Decoder::new();
//! let decoded: Vec<ToArm> = packet[..len].iter().filter_map(|&b| decoder.push(b)?.ok()).collect();
//! assert_eq!(decoded, [hold]);
//! ```

use crate::message::{Failure, HeldBy, Pick, Pose};
use core::fmt;
use serde::{Deserialize, Serialize};

/// Version of the protocol, in the low seven bits of the first byte of every packet in every version.
pub const VERSION: u8 = 1;

/// The high bit of the first byte: set in packets from the arm, so that an echo is not taken for an answer.
const FROM_ARM_BIT: u8 = 0x80;

/// Longest content: version, message, checksum.
const CONTENT_LEN_MAX: usize = 240;

/// Longest packet with its two delimiters: COBS adds one byte per 254 begun.
pub const PACKET_LEN_MAX: usize = CONTENT_LEN_MAX + 3;

/// CRC-32 as in Ethernet, zip and PNG (ISO-HDLC), little-endian on the wire.
const CRC: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
const CRC_LEN: usize = 4;

/// From the cell to the arm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ToArm {
    /// Rises with every command of a session; the same again is the same command again. Hello and heartbeats
    /// carry 0 and are not counted.
    pub sequence: u32,
    /// What is said.
    pub body: ToArmBody,
}

/// What the cell says. The order is the number on the wire: append only.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum ToArmBody {
    /// Open a new session.
    Hello {
        /// Its number, drawn by the cell, not 0.
        session: u32,
        /// So much silence of the cell, ms, and the arm stops and holds.
        heartbeat_timeout_ms: u32,
    },
    /// Execute this.
    Pick(WirePick),
    /// Stop now. Obeyed in every state and session.
    Hold,
    /// End the hold.
    Release {
        /// The session.
        session: u32,
    },
    /// What became of this pick?
    Query {
        /// Its id.
        id: u64,
    },
    /// I am alive.
    Heartbeat {
        /// The session.
        session: u32,
        /// Comes back in the status.
        number: u32,
    },
    /// Leave an alarm.
    Unlock {
        /// The session.
        session: u32,
    },
}

/// A pick on the wire: clocks are not shared, so time is relative; single precision is 0.03 µm at half a metre.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct WirePick {
    /// The session.
    pub session: u32,
    /// Never used twice in the life of a cell.
    pub id: u64,
    /// From the arrival of this packet's last byte to the begin of motion, ms; later it must not begin.
    pub ttl_ms: u32,
    /// Number of the place slot.
    pub slot: u32,
    /// Distance of the fingers at the approach, mm.
    pub opening_mm: f32,
    /// Before the grasp.
    pub approach: WirePose,
    /// Where the fingers close.
    pub grasp: WirePose,
    /// After the fingers closed.
    pub retreat: WirePose,
    /// Where the fingers open.
    pub place: WirePose,
}

/// A pose on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct WirePose {
    /// Tool point in the base frame, mm.
    pub position_mm: [f32; 3],
    /// Base-from-tool rotation, unit quaternion.
    pub orientation_xyzw: [f32; 4],
}

impl From<&Pose> for WirePose {
    fn from(pose: &Pose) -> Self {
        Self {
            position_mm: pose.position_mm.map(|v| v as f32),
            orientation_xyzw: pose.orientation_xyzw.map(|v| v as f32),
        }
    }
}

impl WirePose {
    /// Whether every number is one.
    pub fn is_finite(&self) -> bool {
        self.position_mm.iter().chain(&self.orientation_xyzw).all(|v| v.is_finite())
    }
}

impl WirePick {
    /// `pick` with what is left of its time to live.
    pub fn new(pick: &Pick, ttl_ms: u32) -> Self {
        Self {
            session: pick.session,
            id: pick.id,
            ttl_ms,
            slot: pick.slot,
            opening_mm: pick.opening_mm as f32,
            approach: (&pick.approach).into(),
            grasp: (&pick.grasp).into(),
            retreat: (&pick.retreat).into(),
            place: (&pick.place).into(),
        }
    }

    /// Whether every number is one.
    pub fn is_finite(&self) -> bool {
        let poses = [&self.approach, &self.grasp, &self.retreat, &self.place];
        self.opening_mm.is_finite() && poses.iter().all(|pose| pose.is_finite())
    }
}

/// From the arm to the cell. The order is the number on the wire: append only.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum FromArm {
    /// Answer to Hello: the session of that number has begun, the arm is on hold, what was not begun is dropped.
    /// Sent with session 0, unasked, when the controller has started.
    Welcome(Status),
    /// At every change, as acknowledgement of every command, and as answer to every heartbeat.
    Status(Status),
    /// Answer to a query.
    Outcome {
        /// The id that was asked for.
        id: u64,
        /// The last pick the arm knows, if it is that one.
        progress: Option<Progress>,
    },
}

/// Everything about the arm, so that a lost packet is made good by the next.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// The session; 0 = none since the controller started.
    pub session: u32,
    /// Number of the newest heartbeat that came.
    pub echo: u32,
    /// Sequence of the newest command that came.
    pub acked: u32,
    /// What it does.
    pub arm: ArmState,
    /// It stands out of the cameras' view.
    pub clear_of_view: bool,
    /// It knows where it is.
    pub position_known: bool,
    /// The newest pick it heard of, also from before a restart if it remembers it.
    pub last: Option<LastPick>,
}

/// What the arm does. The order is the number on the wire: append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ArmState {
    /// Stands still until a release.
    Held(HeldBy),
    /// At rest, a pick is welcome.
    Ready,
    /// Has a pick, or moves for another reason.
    Busy,
    /// Stands still until an unlock.
    Alarm {
        /// The arm's own number of it.
        code: u16,
    },
}

/// How far a pick has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LastPick {
    /// Its id.
    pub id: u64,
    /// How far.
    pub progress: Progress,
}

/// How far a pick has come. The order is the number on the wire: append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Progress {
    /// Checked, not begun.
    Accepted,
    /// Under way.
    Moving,
    /// The part lies in its place.
    Done,
    /// Begun, and ended without success.
    Failed(Failure),
    /// Never begun.
    Refused(ArmRefusal),
}

impl Progress {
    /// Whether nothing further will happen to the pick.
    pub fn is_final(self) -> bool {
        !matches!(self, Progress::Accepted | Progress::Moving)
    }
}

/// Why the arm did not begin a pick. The order is the number on the wire: append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ArmRefusal {
    /// It is of another session.
    WrongSession,
    /// The arm is on hold.
    OnHold,
    /// Another pick is unfinished.
    Busy,
    /// The arm is in alarm.
    InAlarm,
    /// The arm does not know where it is.
    PositionUnknown,
    /// Its time to live was over.
    Expired,
    /// A number that is none, or a quaternion that is no rotation.
    NotFinite,
    /// Out of reach.
    Unreachable,
    /// Anything else.
    Other {
        /// The arm's own number of it.
        code: u16,
    },
}

/// A message is longer than [`PACKET_LEN_MAX`] or the buffer is shorter than the packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooLong;

/// Bytes that are no packet of this version.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PacketError {
    /// No packet: too long or short, wrong framing or checksum.
    Garbage {
        /// How many bytes.
        bytes: usize,
    },
    /// A sound packet of another version of the protocol.
    WrongVersion {
        /// Its version.
        theirs: u8,
    },
    /// A sound packet of this version with a content that this side does not know.
    UnknownMessage {
        /// How many bytes.
        bytes: usize,
    },
}

impl fmt::Display for PacketError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            PacketError::Garbage { bytes } => write!(f, "{bytes} bytes that are no packet"),
            PacketError::WrongVersion { theirs } => {
                write!(
                    f,
                    "the other side speaks version {theirs} of the protocol, this side {VERSION}: update one"
                )
            }
            PacketError::UnknownMessage { bytes } => {
                write!(f, "a packet of {bytes} bytes with an unknown message")
            }
        }
    }
}

impl core::error::Error for PacketError {}

/// A message with its direction; implemented by the two enums of this module only.
pub trait Message: Serialize + for<'de> Deserialize<'de> + sealed::Sealed {
    /// The first byte of its packets.
    const FIRST_BYTE: u8;
}

impl Message for ToArm {
    const FIRST_BYTE: u8 = VERSION;
}

impl Message for FromArm {
    const FIRST_BYTE: u8 = VERSION | FROM_ARM_BIT;
}

mod sealed {
    pub trait Sealed {}
    impl Sealed for super::ToArm {}
    impl Sealed for super::FromArm {}
}

/// Writes `message` as a packet (0x00, COBS, 0x00) to the front of `out`; gives its length.
pub fn encode<M: Message>(message: &M, out: &mut [u8]) -> Result<usize, TooLong> {
    let mut content = [0u8; CONTENT_LEN_MAX];
    content[0] = M::FIRST_BYTE;
    let body =
        postcard::to_slice(message, &mut content[1..CONTENT_LEN_MAX - CRC_LEN]).map_err(|_| TooLong)?.len();
    let end = 1 + body;
    let checksum = CRC.checksum(&content[..end]).to_le_bytes();
    content[end..end + CRC_LEN].copy_from_slice(&checksum);
    if out.len() < end + CRC_LEN + 3 {
        return Err(TooLong);
    }
    out[0] = 0;
    let len = cobs::encode(&content[..end + CRC_LEN], &mut out[1..]);
    out[1 + len] = 0;
    Ok(len + 2)
}

/// Cuts a stream of bytes into packets and finds the next one after anything that is none.
#[derive(Clone, Debug)]
pub struct Decoder {
    buffer: [u8; PACKET_LEN_MAX],
    /// Bytes since the last delimiter; may be above the buffer's length, what is beyond is not kept.
    len: usize,
}

impl Decoder {
    /// An empty one.
    pub fn new() -> Self {
        Self { buffer: [0; PACKET_LEN_MAX], len: 0 }
    }

    /// Takes the next byte; gives a message or what is wrong where a packet ends.
    pub fn push<M: Message>(&mut self, byte: u8) -> Option<Result<M, PacketError>> {
        if byte != 0 {
            if let Some(free) = self.buffer.get_mut(self.len) {
                *free = byte;
            }
            self.len = self.len.saturating_add(1);
            return None;
        }
        let bytes = core::mem::take(&mut self.len);
        match bytes {
            0 => None,
            _ if bytes > self.buffer.len() => Some(Err(PacketError::Garbage { bytes })),
            _ => Some(decode(&mut self.buffer[..bytes])),
        }
    }

    /// Bytes since the last delimiter.
    pub fn unfinished(&self) -> usize {
        self.len
    }

    /// Forgets the unfinished packet.
    pub fn clear(&mut self) {
        self.len = 0;
    }
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

/// The content of one packet without its delimiters.
fn decode<M: Message>(packet: &mut [u8]) -> Result<M, PacketError> {
    let bytes = packet.len();
    let garbage = PacketError::Garbage { bytes };
    let len = cobs::decode_in_place(packet).map_err(|_| garbage)?;
    let content = packet.get(..len).ok_or(garbage)?;
    let (content, checksum) = content.split_last_chunk::<CRC_LEN>().ok_or(garbage)?;
    if CRC.checksum(content) != u32::from_le_bytes(*checksum) {
        return Err(garbage);
    }
    let (&first, body) = content.split_first().ok_or(garbage)?;
    if (first ^ M::FIRST_BYTE) & FROM_ARM_BIT != 0 {
        return Err(garbage);
    }
    let theirs = first & !FROM_ARM_BIT;
    if theirs != VERSION {
        return Err(PacketError::WrongVersion { theirs });
    }
    match postcard::take_from_bytes(body) {
        Ok((message, [])) => Ok(message),
        _ => Err(PacketError::UnknownMessage { bytes }),
    }
}

#[cfg(test)]
pub(crate) mod tests;
#[cfg(test)]
mod vectors;
