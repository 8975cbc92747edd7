//! The blocks that Grbl 1.1 understands, and its error numbers for those it does not.

/// What a block leaves behind for the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Modal {
    /// 0 = G0, 1 = G1, 2 and 3 arcs, 80 none.
    motion: u16,
    pub(crate) relative: bool,
    pub(crate) inches: bool,
    pub(crate) feed_mm_min: f64,
}

impl Modal {
    pub(crate) fn new() -> Self {
        Self { motion: 0, relative: false, inches: false, feed_mm_min: 0.0 }
    }
}

/// What a block does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Command {
    None,
    Move { words: [Option<f64>; 3], rapid: bool },
    Dwell(f64),
    Outputs { spindle_on: Option<bool>, coolant_on: Option<bool> },
}

/// A block that was understood.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Block {
    pub(crate) modal: Modal,
    pub(crate) command: Command,
}

/// Modal groups, each at most once a block.
fn group(letter: u8, code: u16) -> Option<u8> {
    Some(match (letter, code) {
        (b'G', 4 | 10 | 28 | 30 | 53 | 92) => 0,
        (b'G', 0 | 1 | 2 | 3 | 38 | 80) => 1,
        (b'G', 17..=19) => 2,
        (b'G', 90 | 91) => 3,
        (b'G', 93 | 94) => 5,
        (b'G', 20 | 21) => 6,
        (b'G', 40) => 7,
        (b'G', 43 | 49) => 8,
        (b'G', 54..=59) => 12,
        (b'G', 61) => 13,
        (b'M', 0 | 1 | 2 | 30) => 14,
        (b'M', 3..=5) => 17,
        (b'M', 8 | 9) => 18,
        _ => return None,
    })
}

/// Reads letter and number; `error:1` or `error:2`.
fn words(line: &str) -> Result<Vec<(u8, f64)>, u8> {
    let bytes = line.as_bytes();
    let mut at = 0;
    let mut words = Vec::new();
    while at < bytes.len() {
        let letter = bytes[at];
        if !letter.is_ascii_uppercase() {
            return Err(1);
        }
        at += 1;
        let begin = at;
        if at < bytes.len() && matches!(bytes[at], b'+' | b'-') {
            at += 1;
        }
        let (mut digits, mut points) = (0, 0);
        while at < bytes.len() && (bytes[at].is_ascii_digit() || (bytes[at] == b'.' && points == 0)) {
            if bytes[at] == b'.' {
                points += 1;
            } else {
                digits += 1;
            }
            at += 1;
        }
        if digits == 0 {
            return Err(2);
        }
        words.push((letter, line[begin..at].parse().map_err(|_| 2u8)?));
    }
    Ok(words)
}

/// A whole block, or the number behind `error:`.
pub(crate) fn parse(line: &str, before: &Modal) -> Result<Block, u8> {
    let mut modal = *before;
    let (mut groups, mut letters) = (0u32, 0u32);
    let mut non_modal = None;
    let (mut spindle_on, mut coolant_on) = (None, None);
    let mut value = [None; 26];
    for (letter, number) in words(line)? {
        if matches!(letter, b'G' | b'M') {
            let code = number.trunc();
            if !(0.0..=255.0).contains(&code) {
                return Err(20);
            }
            if number.fract().abs() > 1e-6 && code != 38.0 && code != 43.0 {
                return Err(if matches!(code as u16, 28 | 30 | 91 | 92) { 20 } else { 23 });
            }
            let code = code as u16;
            let group = group(letter, code).ok_or(20u8)?;
            if groups & 1 << group != 0 {
                return Err(21);
            }
            groups |= 1 << group;
            match (letter, code) {
                (b'G', 0..=3 | 38 | 80) => modal.motion = code,
                (b'G', 4 | 10 | 28 | 30 | 53 | 92) => non_modal = Some(code),
                (b'G', 90 | 91) => modal.relative = code == 91,
                (b'G', 20 | 21) => modal.inches = code == 20,
                (b'M', 3 | 4) => spindle_on = Some(true),
                (b'M', 5) => spindle_on = Some(false),
                (b'M', 8 | 9) => coolant_on = Some(code == 8),
                _ => {}
            }
        } else {
            if !matches!(letter, b'F' | b'I'..=b'L' | b'N' | b'P' | b'R'..=b'T' | b'X'..=b'Z') {
                return Err(20);
            }
            let bit = 1 << (letter - b'A');
            if letters & bit != 0 {
                return Err(25);
            }
            letters |= bit;
            if matches!(letter, b'F' | b'N' | b'P' | b'S' | b'T') && number < 0.0 {
                return Err(4);
            }
            value[usize::from(letter - b'A')] = Some(number);
        }
    }
    let mut take = |letter: u8| value[usize::from(letter - b'A')].take();
    if let Some(feed) = take(b'F') {
        modal.feed_mm_min = if modal.inches { feed * 25.4 } else { feed };
    }
    let speed = take(b'S');
    take(b'N');
    take(b'T');
    let words = [take(b'X'), take(b'Y'), take(b'Z')];
    let any = words.iter().any(Option::is_some);
    let dwell = take(b'P');
    let command = match non_modal {
        Some(4) => Command::Dwell(dwell.ok_or(28u8)?),
        Some(10 | 28 | 30 | 92) => Command::None,
        _ if dwell.is_some() => return Err(36),
        _ if any && modal.motion == 80 => return Err(31),
        // Arcs and probing are no part of this arm.
        _ if any && modal.motion > 1 => return Err(20),
        _ if any && modal.motion == 1 && modal.feed_mm_min <= 0.0 => return Err(22),
        _ if any => Command::Move { words, rapid: modal.motion == 0 },
        _ if spindle_on.is_some() || coolant_on.is_some() || speed.is_some() => {
            // S0 switches the output off.
            let spindle_on = spindle_on.map(|on| on && speed != Some(0.0));
            Command::Outputs { spindle_on, coolant_on }
        }
        _ => Command::None,
    };
    if value.iter().any(Option::is_some) {
        return Err(36);
    }
    Ok(Block { modal, command })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(line: &str) -> u8 {
        parse(line, &Modal::new()).unwrap_err()
    }

    #[test]
    fn blocks_are_understood_or_numbered() {
        let block = parse("G1X10Y-2.5F600", &Modal::new()).unwrap();
        assert_eq!(block.command, Command::Move { words: [Some(10.0), Some(-2.5), None], rapid: false });
        assert_eq!(block.modal.feed_mm_min, 600.0);
        assert_eq!(parse("G90G21G94", &Modal::new()).unwrap().command, Command::None);
        assert_eq!(parse("G4P0", &Modal::new()).unwrap().command, Command::Dwell(0.0));
        assert_eq!((error("10"), error("GX1"), error("G1X1"), error("M400")), (1, 2, 22, 20));
        assert_eq!((error("G0X1G1X2"), error("G0X1X2"), error("G4"), error("G1X1Z")), (21, 25, 28, 2));
        assert_eq!((error("G0X1P2"), error("G0X1A2"), error("G0.5X1"), error("G1X1F-5")), (36, 20, 23, 4));
    }
}
