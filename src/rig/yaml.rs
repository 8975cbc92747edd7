//! The subset of YAML that OpenCV's FileStorage and ROS camera_info files use.
//!
//! `%YAML:1.0` (a directive no strict parser takes), `---`, `key: scalar`, `key: !!opencv-matrix` with rows, cols,
//! dt and data, the same without the tag, and lists of numbers in flow or block form. Everything else (nested
//! maps, strings over lines) is skipped.

/// A value of the top level, as far as a calibration needs it.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Value {
    /// Text behind the colon.
    Scalar(String),
    /// Rows, columns and the numbers row by row.
    Matrix(Matrix),
    /// Something else.
    Other,
}

/// A matrix, or a list of numbers (one row).
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Matrix {
    pub(super) rows: usize,
    pub(super) columns: usize,
    pub(super) data: Vec<f64>,
}

/// What is wrong at a line (counted from 1).
#[derive(Clone, Debug, PartialEq)]
pub(super) struct SyntaxError {
    pub(super) line: usize,
    pub(super) problem: String,
}

/// A key of the top level and its value; an error in a value matters only to who wants that key.
pub(super) type Entry = (String, Result<Value, SyntaxError>);

/// The keys of the top level in the order of the text.
pub(super) fn parse(text: &str) -> Result<Vec<Entry>, SyntaxError> {
    let lines: Vec<&str> = text.lines().map(|l| l.trim_end()).collect();
    let mut entries: Vec<Entry> = Vec::new();
    let mut i = 0;
    while i < lines.len() {
        let line = lines[i];
        if is_nothing(line) || line.starts_with('%') || line.starts_with("---") || line == "..." {
            i += 1;
            continue;
        }
        let Some((key, rest)) = line.split_once(':').filter(|(_, r)| r.is_empty() || r.starts_with(' '))
        else {
            return Err(error(i, format!("\"{}\" is no `key: value`", shown(line))));
        };
        let key = key.trim().trim_matches(['"', '\'']).to_owned();
        let begin = i;
        i += 1;
        while i < lines.len() && is_continued(lines[i]) {
            i += 1;
        }
        if entries.iter().any(|(k, _)| *k == key) {
            return Err(error(begin, format!("{key} is there twice")));
        }
        let value = value(&key, without_comment(rest).trim(), &lines[begin + 1..i], begin);
        entries.push((key, value));
    }
    Ok(entries)
}

/// Whether a line belongs to the key above it.
fn is_continued(line: &str) -> bool {
    line.is_empty() || line.starts_with([' ', '\t', ']', '}', '#']) || line.starts_with("- ")
}

fn is_nothing(line: &str) -> bool {
    let line = line.trim_start();
    line.is_empty() || line.starts_with('#')
}

fn without_comment(text: &str) -> &str {
    if text.trim_start().starts_with('#') { "" } else { text.split(" #").next().unwrap_or("") }
}

fn shown(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).take(40).collect()
}

fn error(line_index: usize, problem: String) -> SyntaxError {
    SyntaxError { line: line_index + 1, problem }
}

/// The value of a key whose line is `begin` (counted from 0) and whose lines below it are `body`.
fn value(key: &str, first: &str, body: &[&str], begin: usize) -> Result<Value, SyntaxError> {
    let tag = first.strip_prefix("!!opencv-matrix").map(str::trim);
    // A map may hold a list, as PyYAML writes `data`, and is none.
    let is_list = || body.iter().find(|l| !is_nothing(l)).is_some_and(|l| l.trim_start().starts_with("- "));
    if first.starts_with('[') || (first.is_empty() && is_list()) {
        return Ok(match numbers(key, first, body, begin, begin + 1)? {
            Some(data) => Value::Matrix(Matrix { rows: 1, columns: data.len(), data }),
            None => Value::Other,
        });
    }
    if tag.is_none() && !first.is_empty() {
        return Ok(Value::Scalar(first.trim_matches(['"', '\'']).to_owned()));
    }
    matrix(key, body, begin, tag.is_some())
}

/// `name` and text of a line `name: text` inside a map.
fn field(line: &str) -> Option<(&str, &str)> {
    let (name, text) = without_comment(line).split_once(':')?;
    let name = name.trim();
    (!name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_'))
        .then_some((name, text.trim()))
}

/// A map of rows, cols, (dt) and data.
fn matrix(key: &str, body: &[&str], begin: usize, tagged: bool) -> Result<Value, SyntaxError> {
    let (mut rows, mut columns, mut data, mut dt) = (None, None, None, None);
    let mut i = 0;
    while i < body.len() {
        let at = begin + 1 + i;
        let Some((name, text)) = field(body[i]) else {
            i += 1;
            continue;
        };
        i += 1;
        match name {
            "rows" | "cols" => {
                let Ok(n) = text.parse::<usize>() else {
                    if tagged {
                        return Err(error(at, format!("{key}: {name} = \"{}\" is no count", shown(text))));
                    }
                    continue;
                };
                if name == "rows" { rows = Some(n) } else { columns = Some(n) }
            }
            "dt" => dt = Some((text.trim_matches(['"', '\'']).to_owned(), at)),
            "data" => {
                let end = i + body[i..].iter().take_while(|l| field(l).is_none()).count();
                data = Some((numbers(key, text, &body[i..end], at, at + 1)?, at));
                i = end;
            }
            _ => {}
        }
    }
    if !tagged && (rows.is_none() || columns.is_none() || data.is_none()) {
        return Ok(Value::Other);
    }
    let (Some(rows), Some(columns), Some((data, at))) = (rows, columns, data) else {
        return Err(error(begin, format!("{key} is a matrix without rows, cols or data")));
    };
    let Some(data) = data else {
        return Err(error(at, format!("{key}: the data are no numbers")));
    };
    if rows.checked_mul(columns) != Some(data.len()) {
        return Err(error(
            at,
            format!("{key} says {rows} rows and {columns} cols but has {} numbers", data.len()),
        ));
    }
    if let Some((dt, at)) = dt.filter(|(dt, _)| !data.is_empty() && dt != "d" && dt != "f") {
        return Err(error(
            at,
            format!("{key}: dt = {} is not d or f (one channel of double or float)", shown(&dt)),
        ));
    }
    Ok(Value::Matrix(Matrix { rows, columns, data }))
}

/// Numbers of a flow list `[ 1., 2. ]` that begins in `first`, or of a block list in `body`. `None` where an item is
/// no number (a list of names, say).
fn numbers(
    key: &str,
    first: &str,
    body: &[&str],
    first_at: usize,
    body_at: usize,
) -> Result<Option<Vec<f64>>, SyntaxError> {
    if first.is_empty() && body.iter().any(|l| l.trim_start().starts_with("- ")) {
        let items = body.iter().filter(|l| !is_nothing(l)).map(|l| {
            let item = without_comment(l).trim();
            item.strip_prefix("- ").and_then(|n| number(n.trim()))
        });
        return Ok(items.collect());
    }
    let mut list = first.to_owned();
    let mut last = first_at;
    for (i, line) in body.iter().enumerate() {
        if list.contains(']') {
            break;
        }
        if !is_nothing(line) {
            last = body_at + i;
            list.push(' ');
            list.push_str(without_comment(line));
        }
    }
    let Some(inside) =
        list.trim().strip_prefix('[').and_then(|l| l.split_once(']')).map(|(inside, _)| inside)
    else {
        return Err(error(last, format!("{key}: the list of numbers does not end with ]")));
    };
    if inside.trim().is_empty() {
        return Ok(Some(Vec::new()));
    }
    Ok(inside.trim().trim_end_matches(',').split(',').map(|n| number(n.trim())).collect())
}

/// A number as OpenCV writes it: `1.`, `-4.1e-04`, `.Inf`, `.Nan`.
fn number(text: &str) -> Option<f64> {
    match text.to_ascii_lowercase().as_str() {
        ".inf" | "+.inf" => Some(f64::INFINITY),
        "-.inf" => Some(f64::NEG_INFINITY),
        ".nan" | "-.nan" => Some(f64::NAN),
        other => other.parse().ok(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn opencv_and_ros_forms_are_read_and_foreign_ones_skipped() {
        let text = "%YAML:1.0\n---\n# note\nimage_width: 640 # px\nname: \"a rig\"\nM1: !!opencv-matrix\n   rows: 1\n   \
                    cols: 3\n   dt: d\n   data: [ 1., -2.5e-03,\n       .Nan ]\nros:\n  rows: 1\n  cols: 2\n  data: [3, 4]\n\
                    py:\n  cols: 2\n  data:\n  - 5.5\n  - -6.0e-1\n  rows: 1\nk:\n- 1.0\n- 2.0\nmap:\n  a: 1\nnames: [ a, b ]\nlist:\n   - { x: 1 }\n";
        let entries = parse(text).unwrap();
        let get = |k: &str| entries.iter().find(|(key, _)| key == k).unwrap().1.clone().unwrap();
        assert_eq!(get("image_width"), Value::Scalar("640".into()));
        assert_eq!(get("name"), Value::Scalar("a rig".into()));
        let Value::Matrix(m) = get("M1") else { panic!("M1 is a matrix") };
        assert_eq!((m.rows, m.columns, m.data[1]), (1, 3, -0.0025));
        assert!(m.data[2].is_nan());
        assert_eq!(get("ros"), Value::Matrix(Matrix { rows: 1, columns: 2, data: vec![3.0, 4.0] }));
        assert_eq!(get("py"), Value::Matrix(Matrix { rows: 1, columns: 2, data: vec![5.5, -0.6] }));
        assert_eq!(get("k"), Value::Matrix(Matrix { rows: 1, columns: 2, data: vec![1.0, 2.0] }));
        assert_eq!((get("map"), get("names"), get("list")), (Value::Other, Value::Other, Value::Other));
    }

    #[test]
    fn what_is_cut_short_or_foreign_is_refused_with_its_line() {
        let cut = "M1: !!opencv-matrix\n   rows: 1\n   cols: 2\n   dt: d\n   data: [ 1., 2.";
        let first = |text: &str| parse(text).unwrap().remove(0).1.unwrap_err();
        assert_eq!(first(cut), error(4, "M1: the list of numbers does not end with ]".into()));
        let few = "M1: !!opencv-matrix\n   rows: 1\n   cols: 2\n   dt: d\n   data: [ 1. ]";
        assert_eq!(first(few).problem, "M1 says 1 rows and 2 cols but has 1 numbers");
        assert_eq!(parse("\u{89}PNG\r\n").unwrap_err().line, 1);
        let vast =
            format!("M1: !!opencv-matrix\n  rows: {m}\n  cols: {m}\n  dt: d\n  data: [ ]", m = usize::MAX);
        assert!(first(&vast).problem.contains("0 numbers"));
        assert_eq!(parse("a: 1\na: 2").unwrap_err(), error(1, "a is there twice".into()));
    }
}
