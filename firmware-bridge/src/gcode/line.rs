//! Lines of text on their way out and in: fixed buffers, fixed decimals, nothing allocated.

/// Longest line that is ever sent, bytes with its end: Marlin takes 96, Grbl 80, uArm 50 (of the command alone).
pub(crate) const LINE_LEN_MAX: usize = 96;

/// A line being made.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LineBuf {
    bytes: [u8; LINE_LEN_MAX],
    len: usize,
    overflow: bool,
}

impl LineBuf {
    /// An empty line.
    pub(crate) const fn new() -> Self {
        Self { bytes: [0; LINE_LEN_MAX], len: 0, overflow: false }
    }

    /// A line of fixed text.
    pub(crate) fn of(text: &str) -> Self {
        let mut line = Self::new();
        line.text(text);
        line
    }

    /// Appends text.
    pub(crate) fn text(&mut self, text: &str) {
        for &byte in text.as_bytes() {
            self.byte(byte);
        }
    }

    /// Appends one byte.
    pub(crate) fn byte(&mut self, byte: u8) {
        if self.len < LINE_LEN_MAX {
            self.bytes[self.len] = byte;
            self.len += 1;
        } else {
            self.overflow = true;
        }
    }

    /// Appends a whole number.
    pub(crate) fn integer(&mut self, mut value: u64) {
        let mut digits = [0u8; 20];
        let mut count = 0;
        loop {
            digits[count] = b'0' + (value % 10) as u8;
            count += 1;
            value /= 10;
            if value == 0 {
                break;
            }
        }
        for &digit in digits[..count].iter().rev() {
            self.byte(digit);
        }
    }

    /// Appends a number with exactly so many decimals (0 to 4), never an exponent, never `-0`. False, and nothing
    /// appended, where it is not finite or not below a million.
    #[must_use]
    pub(crate) fn decimal(&mut self, value: f64, decimals: u8) -> bool {
        let scale = 10u64.pow(u32::from(decimals.min(4)));
        if value.is_nan() || value.abs() >= 1e6 {
            return false;
        }
        let rounded = (value * scale as f64).round() as i64;
        if rounded < 0 {
            self.byte(b'-');
        }
        let rounded = rounded.unsigned_abs();
        self.integer(rounded / scale);
        if decimals > 0 {
            self.byte(b'.');
            let mut rest = rounded % scale;
            let mut place = scale / 10;
            while place > 0 {
                self.byte(b'0' + (rest / place) as u8);
                rest %= place;
                place /= 10;
            }
        }
        true
    }

    /// What has been made.
    pub(crate) fn as_bytes(&self) -> &[u8] {
        &self.bytes[..self.len]
    }

    /// Whether something did not fit.
    pub(crate) fn overflowed(&self) -> bool {
        self.overflow
    }

    /// Bytes so far.
    pub(crate) fn len(&self) -> usize {
        self.len
    }
}

/// Longest line that is understood when it comes in; Marlin's M115 is the longest of interest only at its begin.
const INCOMING_LEN_MAX: usize = 200;

/// A line that came in, without its end. Text only: a line with other bytes is counted as garbage.
#[derive(Clone, Copy)]
pub(crate) struct Incoming {
    bytes: [u8; INCOMING_LEN_MAX],
    len: usize,
}

impl Incoming {
    /// Its text, without white space around it.
    pub(crate) fn text(&self) -> &str {
        core::str::from_utf8(&self.bytes[..self.len]).unwrap_or("").trim()
    }
}

/// Puts incoming bytes together to lines; `\n` and `\r` both end one. What is too long is cut, and bytes that are
/// no printable ASCII spoil their line: it is dropped and counted.
#[derive(Clone, Debug)]
pub(crate) struct Assembler {
    bytes: [u8; INCOMING_LEN_MAX],
    len: usize,
    foreign: u32,
    garbage: u32,
}

impl Assembler {
    pub(crate) const fn new() -> Self {
        Self { bytes: [0; INCOMING_LEN_MAX], len: 0, foreign: 0, garbage: 0 }
    }

    /// Forgets a line begun.
    pub(crate) fn clear(&mut self) {
        self.len = 0;
        self.foreign = 0;
    }

    /// The next byte; a line when it ends one that is not empty.
    pub(crate) fn push(&mut self, byte: u8) -> Option<Incoming> {
        match byte {
            b'\n' | b'\r' => {
                let line = Incoming { bytes: self.bytes, len: self.len };
                let spoilt = self.foreign > 0;
                if spoilt {
                    self.garbage = self.garbage.saturating_add(self.foreign + self.len as u32);
                }
                self.clear();
                (!spoilt && !line.text().is_empty()).then_some(line)
            }
            b' '..=b'~' | b'\t' => {
                if self.len < INCOMING_LEN_MAX {
                    self.bytes[self.len] = byte;
                    self.len += 1;
                }
                None
            }
            _ => {
                self.foreign += 1;
                None
            }
        }
    }

    /// Bytes of spoilt lines since the last call.
    pub(crate) fn take_garbage(&mut self) -> u32 {
        core::mem::take(&mut self.garbage)
    }
}

/// A finite number, or nothing: `nan`, `inf` and exponents are not numbers here.
pub(crate) fn number(text: &str) -> Option<f64> {
    let plain = |c: char| c.is_ascii_digit() || matches!(c, '+' | '-' | '.');
    let text = text.trim();
    if text.is_empty() || !text.chars().all(plain) {
        return None;
    }
    text.parse::<f64>().ok().filter(|v| v.is_finite())
}

/// Three numbers between commas.
pub(crate) fn triple(text: &str) -> Option<[f64; 3]> {
    let mut parts = text.split(',');
    let point = [number(parts.next()?)?, number(parts.next()?)?, number(parts.next()?)?];
    Some(point)
}

/// The digits at the begin of `text` as a number, and what follows them.
pub(crate) fn leading_integer(text: &str) -> Option<(u32, &str)> {
    let end = text.find(|c: char| !c.is_ascii_digit()).unwrap_or(text.len());
    Some((text[..end].parse().ok()?, &text[end..]))
}

/// The number behind `letter` in a reply like `X12.5 Y3` or `X:12.5 Y:3`.
pub(crate) fn word(text: &str, letter: char) -> Option<f64> {
    let mut rest = text;
    while let Some(at) = rest.find(letter) {
        // Firmwares write `X:1.00 Y:2.00`, `X: 1.00 Y: 2.00`, `X1.00 Y2.00` and `X:1.00Y:2.00`.
        let before = rest[..at].chars().next_back();
        let begins = before.is_none_or(|c| c.is_whitespace() || c.is_ascii_digit());
        let value = rest[at + 1..].trim_start_matches(':').trim_start();
        let end = value.find(|c: char| c.is_whitespace() || c.is_ascii_uppercase()).unwrap_or(value.len());
        if begins {
            return number(&value[..end]);
        }
        rest = &rest[at + 1..];
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn decimal(value: f64, decimals: u8) -> Option<String> {
        let mut line = LineBuf::new();
        line.decimal(value, decimals).then(|| String::from_utf8(line.as_bytes().to_vec()).unwrap())
    }

    #[test]
    fn numbers_have_fixed_decimals_and_no_exponent() {
        assert_eq!(decimal(12.3456, 3).unwrap(), "12.346");
        assert_eq!(decimal(-0.0004, 3).unwrap(), "0.000");
        assert_eq!(decimal(-1.5, 0).unwrap(), "-2");
        assert_eq!(decimal(1e-300, 3).unwrap(), "0.000");
        assert_eq!(decimal(f64::NAN, 3), None);
        assert_eq!(decimal(f64::NEG_INFINITY, 3), None);
        assert_eq!(decimal(1e6, 3), None);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]
        #[test]
        fn a_number_comes_back_within_half_a_unit(value in -9e5f64..9e5) {
            let text = decimal(value, 3).unwrap();
            prop_assert!((number(&text).unwrap() - value).abs() <= 0.0005 + 1e-9);
            prop_assert!(text.len() <= 11);
        }
    }

    #[test]
    fn lines_come_together_and_garbage_spoils_only_its_line() {
        let mut assembler = Assembler::new();
        let mut lines = Vec::new();
        for &byte in b"ok\r\n\r\nerr\xFFor:1\nok\n" {
            if let Some(line) = assembler.push(byte) {
                lines.push(line.text().to_owned());
            }
        }
        assert_eq!(lines, ["ok", "ok"]);
        assert_eq!(assembler.take_garbage(), 8);
        assert_eq!(assembler.take_garbage(), 0);
        for _ in 0..10_000 {
            assert!(assembler.push(b'x').is_none());
        }
        assert_eq!(assembler.push(b'\n').unwrap().text().len(), INCOMING_LEN_MAX);
    }

    #[test]
    fn replies_give_finite_numbers_only() {
        assert_eq!(word("X:10.00 Y:-2.50 Z:3 E:0.00 Count X:800", 'Y'), Some(-2.5));
        assert_eq!(word("ok X180.0000 Y0.0000 Z150.0000", 'Z'), Some(150.0));
        assert_eq!(word("ok Xnan Y0", 'X'), None);
        assert_eq!(word("MAX:3", 'X'), None);
        assert_eq!(triple("1.000,2.000,3.000"), Some([1.0, 2.0, 3.0]));
        assert_eq!(triple("1.000,2.000"), None);
        assert_eq!(number("1e5"), None);
    }

    #[test]
    fn coordinates_are_read_with_and_without_colons_and_spaces() {
        for text in
            ["X:1.00 Y:-2.50 Z:3 E:0", "X: 1.00 Y: -2.50 Z: 3 E: 0", "X1.00 Y-2.50 Z3", "X:1.00Y:-2.50Z:3E:0"]
        {
            assert_eq!(
                ['X', 'Y', 'Z'].map(|axis| word(text, axis)),
                [Some(1.0), Some(-2.5), Some(3.0)],
                "{text}"
            );
        }
        for text in ["X:nan Y:1", "X: Y:1", "X1e5 Y:1", "MAX:1 Y:1", "X:1.0.0 Y:1"] {
            assert_eq!(word(text, 'X'), None, "{text}");
        }
    }
}
