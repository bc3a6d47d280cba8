//! Records as text: JSON, JSON lines and YAML. Each object is a row; nested names are joined by dots, and lists of
//! numbers are vectors.
//!
//! A document is a list of records, one record for each key, or one list for each column, whose rows may be numbered keys.
//! Several YAML documents,
//! as `rostopic echo` prints them, are one record each. Several JSON documents, as a program that appends to a file
//! writes them, contain the rows of all.

use std::collections::BTreeSet;

use serde_json::{Map, Value};

use super::csv::{decimal_billionths, text_number};
use super::row_labels::{Levels, RowLabels};
use super::{
    Column, ColumnSettings, Episodes, MAX_COLUMNS, MAX_DEPTH, MAX_PARAMETERS, MAX_WIDTH,
    ReadContext, Table, TableError, clock, first_line, most_frequent, rate_in,
};
use crate::Extent;
use crate::memory_budget::{MemoryBudget, OutOfMemory};

/// Bytes of parsed values per byte of text, at most.
const VALUE_BYTES_PER_BYTE: u64 = 24;
/// Keys of records from 2001 to 2128 are times, s.
const EPOCH_S: std::ops::Range<f64> = 1e9..5e9;
/// Times in names of records that a folder of logs may contain.
const HEAD_KEYS: usize = 64;
/// Keys of the topic, if records of several topics are in one file.
const TOPIC_KEYS: [&str; 4] = ["topic", "channel", "stream", "type"];
const MAX_TOPICS: usize = 64;
/// Of a pose, as a nested list.
pub(super) const MATRIX_ROWS: usize = 4;

/// Whether a text starts like a JSON object or a list of objects or numbers.
pub(crate) fn looks_like_json(bytes: &[u8]) -> bool {
    let text = trimmed(bytes);
    let second = text.get(1..).map_or(b"".as_slice(), <[u8]>::trim_ascii_start).first();
    match text.first() {
        Some(b'{') => matches!(second, Some(b'"' | b'}')),
        Some(b'[') => matches!(second, Some(b'{' | b'[' | b'-' | b'0'..=b'9')),
        _ => false,
    }
}

/// Whether a text starts like YAML: a key with a colon, or a list.
pub(crate) fn looks_like_yaml(bytes: &[u8]) -> bool {
    let text = String::from_utf8_lossy(trimmed(bytes));
    let lines = text.lines().map(str::trim_end);
    let mut lines = lines.filter(|line| {
        !(line.is_empty() || line.starts_with(['#', '%']) || line.starts_with("---"))
    });
    let is_key = |line: &str| {
        line.split_once(':').is_some_and(|(key, rest)| {
            let key = key.trim_matches(['"', '\'']);
            let is_name = |c: char| c.is_alphanumeric() || "_-./ ".contains(c);
            !key.is_empty()
                && key.chars().all(is_name)
                && (rest.is_empty() || rest.starts_with([' ', '\t']))
        })
    };
    lines.next().is_some_and(|line| match line.strip_prefix('-') {
        Some(rest) => rest.is_empty() || rest.starts_with(' '),
        None => is_key(line),
    })
}

/// Whether a text starts with a YAML list of lists or records in brackets, whose commas may look like those of a table.
pub(crate) fn is_yaml_list(bytes: &[u8]) -> bool {
    let text = trimmed(bytes).strip_prefix(b"---").map_or(trimmed(bytes), <[u8]>::trim_ascii_start);
    let Some(item) = text.strip_prefix(b"- ") else { return false };
    matches!(item.trim_ascii_start().first(), Some(b'[' | b'{'))
}

/// Whether most lines of a text are keys or items of YAML, some of them indented. Its lists in brackets may look like
/// rows of a table.
pub(crate) fn is_nested_yaml(bytes: &[u8]) -> bool {
    const LINES: usize = 64;
    const HEAD_BYTES: usize = 1 << 14;
    let head = &bytes[..bytes.len().min(HEAD_BYTES)];
    let text = String::from_utf8_lossy(trimmed(head));
    let (mut count, mut keys, mut indented) = (0, 0, 0);
    for line in text.lines().filter(|line| !line.trim().is_empty()).take(LINES) {
        let is_indented = line.starts_with(' ');
        let line = line.trim_start().trim_start_matches("- ");
        let is_key = line.split_once(':').is_some_and(|(key, rest)| {
            let is_name = |c: char| c.is_alphanumeric() || "_-./".contains(c);
            !key.is_empty()
                && key.chars().all(is_name)
                && (rest.is_empty() || rest.starts_with(' '))
        });
        count += 1;
        keys += usize::from(is_key);
        indented += usize::from(is_key && is_indented);
    }
    indented > 0 && 2 * keys > count && looks_like_yaml(bytes)
}

/// Whether JSON lines that start with `head` have times: they may be a log.
pub(crate) fn has_times(head: &[u8]) -> bool {
    let line = trimmed(head).split(|byte| *byte == b'\n').next().unwrap_or_default();
    let Ok(Value::Object(record)) = serde_json::from_slice(line) else { return false };
    let mut names: Vec<String> = Vec::new();
    collect_names(&record, "", 0, &mut names);
    names.iter().take(HEAD_KEYS).any(|name| clock::is_time(name))
}

fn collect_names(record: &Map<String, Value>, path: &str, depth: usize, names: &mut Vec<String>) {
    for (key, value) in record {
        match value {
            Value::Object(inner) if depth < MAX_DEPTH => {
                collect_names(inner, &joined(path, key), depth + 1, names);
            }
            _ => names.push(joined(path, key)),
        }
    }
}

/// Without a byte-order mark and leading blanks.
fn trimmed(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes).trim_ascii_start()
}

pub(super) fn read_json(bytes: &[u8], context: &mut ReadContext) -> Result<Episodes, TableError> {
    let text = trimmed(bytes);
    check_memory(text.len(), context.memory)?;
    let document = match serde_json::from_slice::<Value>(text) {
        Ok(document) => document,
        Err(error) => {
            let records = match read_lines(text, context)? {
                Some(records) => Some(records),
                None => read_concatenated(text, context)?,
            };
            return match records {
                Some(records) => records.finish(context),
                None => Err(format!("the JSON cannot be read: {error}").into()),
            };
        }
    };
    read_document(document, context)
}

/// Documents one after another, each over several lines; `None` unless there are two.
fn read_concatenated(
    text: &[u8],
    context: &mut ReadContext,
) -> Result<Option<Records>, TableError> {
    let mut documents = serde_json::Deserializer::from_slice(text).into_iter::<Value>();
    let head: Vec<Value> = documents.by_ref().take(2).filter_map(Result::ok).collect();
    let [first, second] = head.as_slice() else { return Ok(None) };
    let are_numbered = have_numbered_keys(first, second);
    let (mut records, mut count) = (Records::default(), 0);
    for document in head.into_iter().map(Ok).chain(documents) {
        match document {
            Ok(document) => {
                count += 1;
                match numbered_record(&document).filter(|_| are_numbered) {
                    Some((key, record)) => records.push_with_key(key, record, context.memory)?,
                    None => records.push_rows(&document, context.memory)?,
                }
            }
            Err(error) => {
                let what = format!("after {count} JSON documents: {error}");
                context.losses.add_unplaced(Extent::Messages, None, what);
                break;
            }
        }
    }
    Ok((!records.columns.is_empty()).then_some(records))
}

/// The record of a document with one numbered key, as in `{"step 3": {…}}`.
fn numbered_record(document: &Value) -> Option<(&str, &Value)> {
    let mut members = document.as_object()?.iter();
    let (key, record) = members.next().filter(|_| members.next().is_none())?;
    let is_numbered = key.ends_with(|c: char| c.is_ascii_digit());
    (is_numbered && record.is_object()).then_some((key, record))
}

/// Whether documents are records below numbers of their own.
fn have_numbered_keys(first: &Value, second: &Value) -> bool {
    let keys = [first, second].map(|document| numbered_record(document).map(|(key, _)| key));
    matches!(keys, [Some(first), Some(second)] if first != second)
}

/// Names and rate of a first record that describes the others: it has no time and no name of the second one, which has
/// times unless the first has their rate.
fn description(first: &Value, second: &Value) -> Option<(Vec<String>, Option<f64>)> {
    let names = |record: &Value| -> Option<Vec<String>> {
        let mut names = Vec::new();
        collect_names(record.as_object()?, "", 0, &mut names);
        Some(names)
    };
    let (own, others) = (names(first)?, names(second)?);
    let rate_hz = rate_in(first);
    let is_of_rows = |name: &String| others.contains(name) || clock::is_time(name);
    let are_rows_timed = rate_hz.is_some() || others.iter().any(|name| clock::is_time(name));
    (are_rows_timed && !own.iter().any(is_of_rows)).then_some((own, rate_hz))
}

/// JSON lines; `None` if the first line is not a record.
fn read_lines(text: &[u8], context: &mut ReadContext) -> Result<Option<Records>, TableError> {
    let mut records = Records::default();
    let mut malformed: Option<(u64, String)> = None;
    let lines = text.split(|byte| *byte == b'\n').enumerate();
    let lines = lines.filter(|(_, line)| !line.trim_ascii().is_empty());
    let head: Vec<Value> =
        lines.clone().take(2).filter_map(|(_, line)| serde_json::from_slice(line).ok()).collect();
    let (description, are_numbered) = match head.as_slice() {
        [first, second] => (description(first, second), have_numbered_keys(first, second)),
        _ => (None, false),
    };
    let lines = lines.skip(usize::from(description.is_some()));
    if let Some((names, rate_hz)) = description {
        let why = "only in the first record, which has no time";
        records.unread.extend(names.into_iter().map(|name| (name, why.to_owned())));
        records.rate_hz = rate_hz;
    }
    for (index, line) in lines {
        match serde_json::from_slice::<Value>(line) {
            Ok(value @ (Value::Object(_) | Value::Array(_))) => {
                match numbered_record(&value).filter(|_| are_numbered) {
                    Some((key, record)) => records.push_with_key(key, record, context.memory)?,
                    None => records.push(&value, context.memory)?,
                }
                records.lines.push(index + 1);
            }
            _ if records.rows == 0 => return Ok(None),
            _ => {
                let what = format!("line {} is not a JSON record", index + 1);
                malformed.get_or_insert((0, what)).0 += 1;
            }
        }
    }
    if let Some((count, first)) = malformed {
        context.losses.add_unplaced(Extent::Messages, Some(count), first);
    }
    Ok(Some(records))
}

pub(super) fn read_yaml(bytes: &[u8], context: &mut ReadContext) -> Result<Episodes, TableError> {
    let text = std::str::from_utf8(trimmed(bytes))
        .map_err(|error| format!("the YAML cannot be read: {error}"))?;
    check_memory(text.len(), context.memory)?;
    let mut documents: Vec<String> = vec![String::new()];
    let key = |line: &str| {
        let key = line.split_once(':')?.0;
        key.starts_with(char::is_alphabetic).then(|| key.to_owned())
    };
    let is_content = |line: &&str| !line.trim().is_empty() && !line.starts_with(['#', '%', '-']);
    let first_key = text.lines().find(is_content).and_then(key);
    for line in text.lines() {
        match line.trim_end() {
            "---" => documents.push(String::new()),
            line => {
                // A key cannot repeat: another record begins.
                let has_content = |text: &String| text.lines().any(|line| is_content(&line));
                if first_key.is_some()
                    && key(line) == first_key
                    && documents.last().is_some_and(has_content)
                {
                    documents.push(String::new());
                }
                let last = documents.last_mut();
                last.into_iter().for_each(|last| last.extend([line, "\n"]));
            }
        }
    }
    documents.retain(|document| !document.trim().is_empty());
    if let [only] = documents.as_slice() {
        return read_document(parse_yaml(only)?, context);
    }
    let mut records = Records::default();
    let mut malformed: Option<(u64, String)> = None;
    for document in &documents {
        match parse_yaml(document) {
            Ok(value) => records.push(&value, context.memory)?,
            // The last one may be cut.
            Err(error) => malformed.get_or_insert((0, error.to_string())).0 += 1,
        }
    }
    if let Some((count, first)) = malformed {
        context.losses.add_unplaced(Extent::Messages, Some(count), first);
    }
    records.finish(context)
}

fn parse_yaml(document: &str) -> Result<Value, TableError> {
    // Aliases may not multiply the text.
    let nodes = document.len().max(1000);
    let budget = serde_saphyr::budget! {
        max_nodes: nodes,
        max_events: 2 * nodes,
        max_total_scalar_bytes: nodes,
    };
    let options = serde_saphyr::options! { budget: budget };
    serde_saphyr::from_str_with_options(document, options).map_err(|error| {
        format!("the YAML cannot be read: {}", yaml_problem(&first_line(&error))).into()
    })
}

/// Without the advice that the parser gives to programmers.
fn yaml_problem(text: &str) -> &str {
    let problem = text.strip_prefix("error: ").unwrap_or(text);
    problem.split_once(", set ").map_or(problem, |(problem, _)| problem)
}

/// Names in a JSON document that may be a single record. `None` if it has rows.
pub(super) fn names_in_json_record(bytes: &[u8]) -> Option<BTreeSet<String>> {
    names_in_record(&serde_json::from_slice(trimmed(bytes)).ok()?)
}

/// Names in a YAML document that may be a single record. `None` if it has rows.
pub(super) fn names_in_yaml_record(bytes: &[u8]) -> Option<BTreeSet<String>> {
    let text = std::str::from_utf8(trimmed(bytes)).ok()?;
    names_in_record(&parse_yaml(text).ok()?)
}

fn names_in_record(document: &Value) -> Option<BTreeSet<String>> {
    let members = document.as_object()?;
    let is_record = match Shape::of(members) {
        Shape::One => true,
        // They may be matrices.
        Shape::Columns(lists) => lists.iter().all(|(_, list)| list.len() <= MATRIX_ROWS),
        Shape::ByKey(_) | Shape::Lists(_) => false,
    };
    let mut names = Vec::new();
    collect_names(members, "", 0, &mut names);
    is_record.then(|| names.into_iter().collect())
}

fn check_memory(bytes: usize, memory: &MemoryBudget) -> Result<(), OutOfMemory> {
    memory.check_available((bytes as u64).saturating_mul(VALUE_BYTES_PER_BYTE))
}

fn read_document(document: Value, context: &mut ReadContext) -> Result<Episodes, TableError> {
    let document = with_numbered_lists(document);
    let mut records = Records { rate_hz: rate_in(&document), ..Records::default() };
    match &document {
        Value::Object(members) if let Shape::Columns(columns) = Shape::of(members) => {
            return read_columns(&columns, records, context);
        }
        Value::Array(_) | Value::Object(_) => records.push_rows(&document, context.memory)?,
        _ => return Err("it contains no records".into()),
    }
    if records.columns.is_empty() {
        return Err("it contains no rows of numbers".into());
    }
    records.finish(context)
}

/// Makes a list of each member whose keys are consecutive numbers from 0 or 1, as in `{"hand": {"1": …, "2": …}}` and in
/// tables that pandas writes. These are rows, unless the members themselves are numbered, and more than the rows.
fn with_numbered_lists(mut document: Value) -> Value {
    let Value::Object(members) = &mut document else { return document };
    let is_numbered = |value: &Value| value.as_object().is_some_and(has_numbers_as_keys);
    let stem = |key: &str| key.trim_end_matches(|c: char| c.is_ascii_digit()).to_owned();
    let keys: Vec<&String> =
        members.iter().filter(|(_, value)| is_numbered(value)).map(|(key, _)| key).collect();
    let stems: BTreeSet<String> = keys.iter().map(|key| stem(key)).collect();
    let lengths = members.values().filter(|value| is_numbered(value));
    let lengths = lengths.filter_map(|value| Some(value.as_object()?.len()));
    if stems.len() < keys.len() && lengths.max().unwrap_or(0) <= keys.len() {
        return document;
    }
    for value in members.values_mut().filter(|value| is_numbered(value)) {
        let Value::Object(rows) = value.take() else { continue };
        let mut rows: Vec<(usize, Value)> =
            rows.into_iter().filter_map(|(key, row)| Some((key.parse().ok()?, row))).collect();
        rows.sort_by_key(|(number, _)| *number);
        *value = rows.into_iter().map(|(_, row)| row).collect();
    }
    document
}

fn has_numbers_as_keys(members: &Map<String, Value>) -> bool {
    let numbers: Option<BTreeSet<usize>> = members.keys().map(|key| key.parse().ok()).collect();
    numbers.is_some_and(|numbers| {
        let first = numbers.first().copied().unwrap_or(usize::MAX);
        first <= 1 && members.len() > 1 && numbers.into_iter().eq(first..first + members.len())
    })
}

/// A table for the most frequent length, then one for each other length with times of its own.
fn read_columns(
    lists: &[(String, &[Value])],
    mut main: Records,
    context: &mut ReadContext,
) -> Result<Episodes, TableError> {
    let rows = most_frequent(lists.iter().map(|(_, list)| list.len()));
    let lengths: BTreeSet<usize> = lists.iter().map(|(_, list)| list.len()).collect();
    let mut tables = Vec::new();
    for length in lengths {
        let own: Vec<&(String, &[Value])> =
            lists.iter().filter(|(_, list)| list.len() == length).collect();
        if length == rows {
            main.push_columns(&own, context.memory)?;
            continue;
        }
        let mut records = Records::default();
        if own.len() > 1 {
            records.push_columns(&own, context.memory)?;
        }
        let found = records.finish(context)?;
        let has_clock = |(_, table): &(String, Table)| {
            table.columns.len() > 1 && clock::detect(table, &ColumnSettings::default()).is_ok()
        };
        match found.iter().all(has_clock) {
            true => tables.extend(found),
            false => {
                let why = format!("{length} rows, not {rows}");
                main.unread.extend(own.iter().map(|(name, _)| (name.clone(), why.clone())));
            }
        }
    }
    if main.columns.is_empty() {
        return Err("it contains no rows of numbers".into());
    }
    Ok([main.finish(context)?, tables].concat())
}

/// Layout of an object.
enum Shape<'a> {
    /// One record for each key.
    ByKey(Vec<(&'a str, &'a Value)>),
    /// Lists of records with the same keys, in any depth.
    Lists(Vec<&'a [Value]>),
    /// A list for each column, of the same length.
    Columns(Vec<(String, &'a [Value])>),
    /// A single record.
    One,
}

impl<'a> Shape<'a> {
    fn of(members: &'a Map<String, Value>) -> Self {
        let records: Vec<(&str, &Value)> = members
            .iter()
            .filter(|(_, value)| value.is_object())
            .map(|(key, value)| (key.as_str(), value))
            .collect();
        let keys = |value: &'a Value| value.as_object().map(|own| own.keys().collect::<Vec<_>>());
        let first = records.first().and_then(|(_, value)| keys(value));
        let is_alike = records.iter().all(|(_, value)| keys(value) == first);
        if records.len() > 1 && 2 * records.len() > members.len() && is_alike {
            return Self::ByKey(records);
        }
        let mut lists: Vec<(String, &[Value])> = Vec::new();
        collect_lists(members, "", 0, &mut lists);
        let of_records = |list: &&[Value]| list.iter().any(Value::is_object);
        let of_records = || lists.iter().map(|(_, list)| *list).filter(of_records);
        if let Some(longest) = of_records().max_by_key(|list| list.len()) {
            let keys = |list: &'a [Value]| list.iter().find_map(keys);
            let own = keys(longest);
            return Self::Lists(of_records().filter(|list| keys(list) == own).collect());
        }
        // A vector in a single record has as many numbers as an arm has joints, and a matrix as few rows.
        let lengths = || lists.iter().map(|(_, list)| list.len());
        let longest = lengths().max().unwrap_or(0);
        let common = most_frequent(lengths());
        let others = lengths().filter(|length| *length != common).count();
        let are_rows = others == 0 || (common > MATRIX_ROWS && 2 * others <= lists.len());
        let is_nested = lists.iter().any(|list| list.1.iter().any(Value::is_array));
        let is_long = longest > MAX_WIDTH || (lists.len() > 1 && longest > MAX_PARAMETERS);
        match is_long || (is_nested && are_rows) {
            true => Self::Columns(lists),
            false => Self::One,
        }
    }
}

fn collect_lists<'a>(
    members: &'a Map<String, Value>,
    path: &str,
    depth: usize,
    lists: &mut Vec<(String, &'a [Value])>,
) {
    for (key, value) in members {
        match value {
            Value::Array(items) if !items.is_empty() => lists.push((joined(path, key), items)),
            Value::Object(inner) if depth < MAX_DEPTH => {
                collect_lists(inner, &joined(path, key), depth + 1, lists);
            }
            _ => {}
        }
    }
}

fn joined(path: &str, key: &str) -> String {
    if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") }
}

#[derive(Default)]
struct Records {
    rows: usize,
    columns: Vec<Column>,
    /// Number of text cells in each column, and the first one.
    texts: Vec<(usize, String)>,
    /// The texts of each column, unless they are many.
    levels: Vec<Levels<String>>,
    lines: Vec<usize>,
    rate_hz: Option<f64>,
    unread: Vec<(String, String)>,
    /// Rows whose vectors have another width, and the first one.
    uneven: Option<(u64, String)>,
    /// Topic of each record that names one.
    topics: Vec<String>,
}

impl Records {
    fn push(&mut self, record: &Value, memory: &mut MemoryBudget) -> Result<(), TableError> {
        let topic = TOPIC_KEYS.iter().find_map(|key| record.get(*key)?.as_str());
        if let Some(topic) = topic.filter(|_| self.topics.len() == self.rows) {
            memory.check_available((self.topics.len() * size_of::<String>()) as u64)?;
            self.topics.push(topic.to_owned());
        }
        self.add(record, "", 0, memory)?;
        self.end_row(memory)
    }

    /// The rows of a document. Lists for columns become one row.
    fn push_rows(&mut self, document: &Value, memory: &mut MemoryBudget) -> Result<(), TableError> {
        match document {
            Value::Array(items) => items.iter().try_for_each(|item| self.push(item, memory)),
            Value::Object(members) => match Shape::of(members) {
                Shape::ByKey(rows) => {
                    rows.into_iter().try_for_each(|(key, row)| self.push_with_key(key, row, memory))
                }
                Shape::Lists(lists) => {
                    lists.into_iter().flatten().try_for_each(|item| self.push(item, memory))
                }
                Shape::Columns(_) | Shape::One => self.push(document, memory),
            },
            _ => Ok(()),
        }
    }

    fn push_with_key(
        &mut self,
        key: &str,
        record: &Value,
        memory: &mut MemoryBudget,
    ) -> Result<(), TableError> {
        if let Ok(number) = key.parse::<f64>() {
            let name = if EPOCH_S.contains(&number) { "time" } else { "key" };
            self.put(name, &[number], memory)?;
        }
        self.push(record, memory)
    }

    /// Lists of the same length.
    fn push_columns(
        &mut self,
        lists: &[&(String, &[Value])],
        memory: &mut MemoryBudget,
    ) -> Result<(), TableError> {
        for row in 0..lists.first().map_or(0, |(_, list)| list.len()) {
            for (name, list) in lists {
                self.add(&list[row], name, 0, memory)?;
            }
            self.end_row(memory)?;
        }
        Ok(())
    }

    fn add(
        &mut self,
        value: &Value,
        path: &str,
        depth: usize,
        memory: &mut MemoryBudget,
    ) -> Result<(), TableError> {
        let name = if path.is_empty() { "array" } else { path };
        match value {
            _ if depth > MAX_DEPTH => {}
            Value::Object(members) => {
                for (key, value) in members {
                    self.add(value, &joined(path, key), depth + 1, memory)?;
                }
            }
            Value::Array(items) => {
                let mut numbers = Vec::new();
                if flatten(items, 0, &mut numbers) {
                    self.put(name, &numbers, memory)?;
                } else {
                    for (at, item) in items.iter().enumerate().take(MAX_WIDTH) {
                        self.add(item, &format!("{path}[{at}]"), depth + 1, memory)?;
                    }
                }
            }
            Value::Number(number) => {
                let at = self.put(name, &[number.as_f64().unwrap_or(f64::NAN)], memory)?;
                self.put_exact(at, &number.to_string(), memory)?;
            }
            Value::Bool(is_set) => _ = self.put(name, &[f64::from(u8::from(*is_set))], memory)?,
            Value::String(text) => {
                let number = text_number(text.as_bytes());
                let at = self.put(name, &[number], memory)?;
                if let (Some(at), true) = (at, number.is_nan()) {
                    let (count, first) = &mut self.texts[at];
                    *count += 1;
                    if first.is_empty() {
                        first.clone_from(text);
                    }
                    memory.reserve(2)?;
                    self.levels[at].push(self.rows, text.clone());
                }
                self.put_exact(at, text, memory)?;
            }
            Value::Null => {}
        }
        Ok(())
    }

    /// Index of the column; `None` beyond the limits, or if the width differs.
    fn put(
        &mut self,
        name: &str,
        numbers: &[f64],
        memory: &mut MemoryBudget,
    ) -> Result<Option<usize>, TableError> {
        let width = numbers.len();
        let found = self.columns.iter().position(|column| column.name == name);
        let at = match found {
            Some(at) => at,
            None if width == 0 || width > MAX_WIDTH || self.columns.len() == MAX_COLUMNS => {
                return Ok(None);
            }
            None => {
                self.columns.push(Column::untyped(name, width, Vec::new()));
                self.texts.push((0, String::new()));
                self.levels.push(Levels::default());
                self.columns.len() - 1
            }
        };
        let column = &mut self.columns[at];
        let before = self.rows * column.width;
        // Missing rows, and a name that is repeated within a record.
        memory.reserve((before + width).saturating_sub(column.values.len()))?;
        column.values.resize(before, f64::NAN);
        if width != column.width {
            let what = format!("'{name}' has {width} numbers, not {}", column.width);
            self.uneven.get_or_insert((0, what)).0 += 1;
            return Ok(None);
        }
        column.values.extend_from_slice(numbers);
        Ok(Some(at))
    }

    /// Keeps the digits of a time.
    fn put_exact(
        &mut self,
        at: Option<usize>,
        text: &str,
        memory: &mut MemoryBudget,
    ) -> Result<(), TableError> {
        let Some(column) = at.map(|at| &mut self.columns[at]) else { return Ok(()) };
        if column.width == 1 && clock::is_time(&column.name) {
            memory.reserve(4 * (self.rows + 1).saturating_sub(column.billionths.len()))?;
            column.billionths.resize(self.rows, None);
            column.billionths.push(decimal_billionths(text.as_bytes(), false));
        }
        Ok(())
    }

    fn end_row(&mut self, memory: &mut MemoryBudget) -> Result<(), TableError> {
        memory.reserve(1)?;
        self.rows += 1;
        Ok(())
    }

    fn finish(self, context: &mut ReadContext) -> Result<Episodes, TableError> {
        let rows = self.rows;
        if let Some((count, first)) = self.uneven {
            context.losses.add_unplaced(Extent::Messages, Some(count), first);
        }
        let mut table = Table {
            rows,
            rate_hz: self.rate_hz,
            lines: self.lines,
            unread: self.unread,
            ..Table::default()
        };
        let (columns, texts) = (self.columns, self.texts);
        let names = topic_names(&columns, &self.topics, rows);
        let texts = texts.into_iter().zip(self.levels);
        for ((column, ((texts, first), levels)), topics) in
            columns.into_iter().zip(texts).zip(names)
        {
            let mut column = column;
            let missing = (rows * column.width).saturating_sub(column.values.len());
            if let Err(refusal) = context.memory.reserve(missing) {
                TableError::from(refusal).report(Some(rows as u64), context.losses);
                continue;
            }
            column.values.resize(rows * column.width, f64::NAN);
            if !column.billionths.is_empty() {
                column.billionths.resize(rows, None);
            }
            let finite = column.values.iter().filter(|value| value.is_finite()).count();
            // Records of other streams lack the number.
            let is_numeric = finite > 0 && finite >= texts;
            match (is_numeric, texts) {
                (true, _) if !topics.is_empty() => {
                    context.memory.reserve(column.values.len() * topics.len())?;
                    table.columns.extend(split_by_topic(&column, &self.topics, &topics));
                }
                (true, _) => table.columns.push(column),
                (false, 0) => {
                    table.unread.push((column.name, "none of its rows has a number".to_owned()));
                }
                (false, _) => {
                    table.texts.insert(column.name.clone(), first);
                    table.labels.extend(RowLabels::of_texts(&column.name, rows, &levels));
                    table.unread.push((column.name, "text, not numbers".to_owned()));
                }
            }
        }
        Ok(vec![("0".to_owned(), table)])
    }
}

/// Topics of the records that have each column, if records of several topics have different columns. Empty for columns
/// of times and of records without topics.
fn topic_names(columns: &[Column], topics: &[String], rows: usize) -> Vec<Vec<String>> {
    let distinct: BTreeSet<&String> = topics.iter().collect();
    let of_column = |column: &Column| -> Vec<String> {
        if clock::is_time(&column.name) {
            return Vec::new();
        }
        let own = (0..rows.min(topics.len())).filter(|row| column.has_numbers(*row));
        own.map(|row| &topics[row]).collect::<BTreeSet<_>>().into_iter().cloned().collect()
    };
    let found: Vec<Vec<String>> = columns.iter().map(of_column).collect();
    let is_partial = |own: &Vec<String>| !own.is_empty() && own.len() < distinct.len();
    let are_split = topics.len() == rows
        && (2..=MAX_TOPICS).contains(&distinct.len())
        && found.iter().any(is_partial);
    if are_split { found } else { vec![Vec::new(); columns.len()] }
}

/// A column for each topic, named after both.
fn split_by_topic(column: &Column, topics: &[String], own: &[String]) -> Vec<Column> {
    let of_topic = |topic: &String| {
        let rows = column.values.chunks(column.width).zip(topics);
        let values = rows.flat_map(|(row, its)| {
            row.iter().map(move |value| if its == topic { *value } else { f64::NAN })
        });
        Column {
            name: joined(topic.trim_matches('/'), &column.name),
            kind: column.kind.clone(),
            width: column.width,
            values: values.collect(),
            ..Column::default()
        }
    };
    own.iter().map(of_topic).collect()
}

/// Appends nested numbers. False if there is anything else, or too many.
fn flatten(items: &[Value], depth: usize, numbers: &mut Vec<f64>) -> bool {
    items.iter().all(|item| match item {
        Value::Number(number) => {
            numbers.push(number.as_f64().unwrap_or(f64::NAN));
            numbers.len() <= MAX_WIDTH
        }
        Value::Null => {
            numbers.push(f64::NAN);
            numbers.len() <= MAX_WIDTH
        }
        Value::Array(items) => depth < MAX_DEPTH && flatten(items, depth + 1, numbers),
        _ => false,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_problem_of_a_yaml_document_is_stated_without_advice_to_programmers() {
        let error = parse_yaml("a:\n  x: 1\n  x: 2\n").expect_err("a repeated key").to_string();
        assert!(error.ends_with("duplicate mapping key: x"), "{error}");
        assert!(error.starts_with("the YAML cannot be read: line"), "{error}");
    }
}
