//! Integrity of a database's write-ahead log. SQLite reads it up to the first invalid checksum and does not
//! report the rest.
//!
//! Format: <https://www.sqlite.org/fileformat2.html#walformat>.

use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;

const HEADER_BYTES: u64 = 32;
const FRAME_HEADER_BYTES: u64 = 24;
const MAX_PAGE_BYTES: u32 = 1 << 16;

/// Offset and description of damage; `None` if all frames are readable and belong to completed
/// transactions.
pub(super) fn damage(path: &Path) -> io::Result<Option<(u64, String)>> {
    let file = File::open(path)?;
    let length = file.metadata()?.len();
    if length < HEADER_BYTES {
        let what = format!("truncated: {length} bytes are too few for a header");
        return Ok(Some((0, what)));
    }
    let mut file = BufReader::new(file);
    let mut header = [0; HEADER_BYTES as usize];
    file.read_exact(&mut header)?;
    let word = |bytes: &[u8], at: usize| {
        bytes[at..at + 4].iter().fold(0_u32, |word, byte| word << 8 | u32::from(*byte))
    };
    let page_bytes = word(&header, 8);
    // The lowest bit of the magic number selects the byte order.
    let sum = |mut sum: [u32; 2], bytes: &[u8]| {
        let is_big = header[3] & 1 == 1;
        for pair in bytes.chunks_exact(8) {
            let read = |at: usize| match is_big {
                true => word(pair, at),
                false => word(pair, at).swap_bytes(),
            };
            sum[0] = sum[0].wrapping_add(read(0)).wrapping_add(sum[1]);
            sum[1] = sum[1].wrapping_add(read(4)).wrapping_add(sum[0]);
        }
        sum
    };
    let mut so_far = sum([0, 0], &header[..24]);
    let is_page = page_bytes.is_power_of_two() && (512..=MAX_PAGE_BYTES).contains(&page_bytes);
    if word(&header, 0) | 1 != 0x377f_0683
        || !is_page
        || so_far != [word(&header, 24), word(&header, 28)]
    {
        return Ok(Some((0, "header damaged: nothing can be read".to_owned())));
    }
    let frame_bytes = FRAME_HEADER_BYTES + u64::from(page_bytes);
    let frames = (length - HEADER_BYTES) / frame_bytes;
    let mut frame = vec![0; usize::try_from(frame_bytes).unwrap_or(0)];
    let (mut sound, mut ended) = (0, 0);
    for index in 0..frames {
        file.read_exact(&mut frame)?;
        // Frames with another salt are of transactions already in the database.
        if frame[8..16] != header[16..24] {
            continue;
        }
        so_far = sum(sum(so_far, &frame[..8]), &frame[FRAME_HEADER_BYTES as usize..]);
        if index != sound || so_far != [word(&frame, 16), word(&frame, 20)] {
            let at = HEADER_BYTES + sound * frame_bytes;
            return Ok(Some((at, format!("frames from {} on cannot be read", sound + 1))));
        }
        sound += 1;
        if word(&frame, 4) != 0 {
            ended = sound;
        }
    }
    let end = HEADER_BYTES + sound * frame_bytes;
    if end < length && sound == frames {
        return Ok(Some((end, format!("truncated within frame {}", sound + 1))));
    }
    let open = sound - ended;
    Ok((open > 0).then(|| {
        (
            HEADER_BYTES + ended * frame_bytes,
            format!("the last {open} frames belong to an incomplete transaction"),
        )
    }))
}
