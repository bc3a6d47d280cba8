//! KUKA Robot Sensor Interface: dumps of the controller's text packets.
//!
//! A `<Rob>` packet is a row: measured and commanded poses (`RIst`, `RSol`), axes (`AIPos`, `ASPos`) and
//! the controller's clock (`IPOC`, ms). Replies (`<Sen>`) and other text are skipped.

use std::ops::Range;

use ground::robot::xml_document;
use roxmltree::Node;

use super::{Column, Episodes, ReadColumn, ReadContext, Table, TableError};
use crate::Extent;

/// Elements and their attributes.
const ELEMENTS: &[(&str, &[&str])] = &[
    ("RIst", &["X", "Y", "Z", "A", "B", "C"]),
    ("RSol", &["X", "Y", "Z", "A", "B", "C"]),
    ("AIPos", &["A1", "A2", "A3", "A4", "A5", "A6"]),
    ("ASPos", &["A1", "A2", "A3", "A4", "A5", "A6"]),
];
const CLOCK: &str = "IPOC";
const PACKET_START: &[u8] = b"<Rob";
const PACKET_END: &[u8] = b"</Rob>";
/// Maximum size of a datagram.
const MAX_PACKET_BYTES: usize = 1 << 16;

pub(crate) fn has_packet(bytes: &[u8]) -> bool {
    let Some(at) = find_packet(bytes, 0) else { return false };
    let rest = &bytes[at..];
    ["RIst", "AIPos", CLOCK]
        .iter()
        .any(|name| find(rest, format!("<{name}").as_bytes(), 0).is_some())
}

pub(super) fn read(bytes: &[u8], context: &mut ReadContext) -> Result<Episodes, TableError> {
    let losses = &mut *context.losses;
    let wide: usize = ELEMENTS.iter().map(|(_, numbers)| numbers.len()).sum();
    let mut values: Vec<Vec<f64>> = vec![Vec::new(); ELEMENTS.len()];
    let mut clock = Vec::new();
    let mut malformed: Option<(usize, u64, String)> = None;
    let mut at = 0;
    while let Some(packet) = next_packet(bytes, at) {
        at = packet.end;
        context.memory.reserve(wide + 1)?;
        let mut row = vec![f64::NAN; wide + 1];
        match parse_packet(&bytes[packet.clone()], &mut row) {
            Ok(()) => {
                clock.push(row[wide]);
                let mut rest = row.as_slice();
                for (own, (_, names)) in values.iter_mut().zip(ELEMENTS) {
                    let (numbers, behind) = rest.split_at(names.len());
                    own.extend_from_slice(numbers);
                    rest = behind;
                }
            }
            // The last packet of a dump is usually truncated.
            Err(_)
                if find_packet(bytes, at).is_none()
                    && !bytes[packet.clone()].ends_with(PACKET_END) =>
            {
                losses.add(
                    packet.start,
                    Extent::Tail,
                    Some(1),
                    "the last packet is truncated".into(),
                );
            }
            Err(what) => malformed.get_or_insert((packet.start, 0, what)).1 += 1,
        }
    }
    if let Some((offset, count, what)) = malformed {
        losses.add(
            offset,
            Extent::Messages,
            Some(count),
            format!("a packet is not valid XML: {what}"),
        );
    }
    let column = |name: &str, parts: &[&str], values: Vec<f64>| Column {
        parts: parts.iter().map(|part| (*part).to_owned()).collect(),
        ..Column::untyped(name, parts.len().max(1), values)
    };
    let rows = clock.len();
    let is_there = |values: &[f64]| values.iter().any(|value| value.is_finite());
    let columns = ELEMENTS
        .iter()
        .zip(values)
        .map(|((name, parts), values)| column(name, parts, values))
        .chain([column(CLOCK, &[], clock)])
        .filter(|column| is_there(&column.values))
        .map(ReadColumn::complete);
    Ok(vec![("0".to_owned(), Table::from_columns(columns.collect(), Some(rows), context.memory))])
}

/// Up to its end or the start of the next packet.
fn next_packet(bytes: &[u8], at: usize) -> Option<Range<usize>> {
    let start = find_packet(bytes, at)?;
    let reach = bytes.len().min(start + MAX_PACKET_BYTES);
    let reach = find_packet(&bytes[..reach], start + PACKET_START.len()).unwrap_or(reach);
    let close = find(&bytes[..reach], PACKET_END, start);
    Some(start..close.map_or(reach, |close| close + PACKET_END.len()))
}

fn find_packet(bytes: &[u8], mut at: usize) -> Option<usize> {
    loop {
        let start = find(bytes, PACKET_START, at)?;
        at = start + PACKET_START.len();
        if let Some(b'>' | b' ' | b'\t' | b'\r' | b'\n') = bytes.get(at) {
            return Some(start);
        }
    }
}

fn find(bytes: &[u8], what: &[u8], at: usize) -> Option<usize> {
    memchr::memmem::find(bytes.get(at..)?, what).map(|found| at + found)
}

/// Missing numbers are NaN.
fn parse_packet(packet: &[u8], row: &mut [f64]) -> Result<(), String> {
    let text = std::str::from_utf8(packet).map_err(|error| error.to_string())?;
    let packet = xml_document(text).map_err(|(_, problem)| problem.to_string())?;
    let number = |text: &str| text.trim().parse::<f64>().unwrap_or(f64::NAN);
    let child = |name| packet.root_element().children().find(|node: &Node| node.has_tag_name(name));
    let mut cells = row.iter_mut();
    for (name, attributes) in ELEMENTS {
        let element = child(*name);
        for (attribute, cell) in attributes.iter().zip(&mut cells) {
            let text = element.and_then(|element| element.attribute(*attribute));
            *cell = text.map_or(f64::NAN, number);
        }
    }
    if let Some(cell) = cells.next() {
        *cell = child(CLOCK).and_then(|node| node.text()).map_or(f64::NAN, number);
    }
    Ok(())
}
