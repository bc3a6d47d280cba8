//! Writes small HDF5 files for tests: data sets of doubles, named by path.
//!
//! Format: HDF5 File Format Specification 3.0, superblock 0 and object headers of version 1.

const UNDEFINED: [u8; 8] = [0xff; 8];

/// Row-major.
pub(crate) struct DataSet<'a> {
    pub name: &'a str,
    pub width: usize,
    pub values: Vec<f64>,
    /// Each row is a chunk; those in `missing` are not written.
    pub is_chunked: bool,
    pub missing: &'a [bool],
}

/// Each name in `loops` links to the root group.
pub(crate) fn hdf5(sets: &[DataSet<'_>], loops: &[&str]) -> Vec<u8> {
    // Written last: it contains the address of the root group and the file length.
    const SUPERBLOCK: usize = 96;
    let mut file = vec![0; SUPERBLOCK];
    let sets: Vec<(&str, &DataSet<'_>)> = sets.iter().map(|set| (set.name, set)).collect();
    let root = add_group(&mut file, &sets, loops);
    let superblock = [
        &b"\x89HDF\r\n\x1a\n"[..],
        &[0, 0, 0, 0, 0, 8, 8, 0, 4, 0, 16, 0, 0, 0, 0, 0],
        &[0; 8],
        &UNDEFINED,
        &(file.len() as u64).to_le_bytes(),
        &UNDEFINED,
        &[0; 8],
        &root.to_le_bytes(),
        &[0; 24],
    ]
    .concat();
    file[..SUPERBLOCK].copy_from_slice(&superblock);
    file
}

/// Data sets by their path in the group; returns the address.
fn add_group(file: &mut Vec<u8>, sets: &[(&str, &DataSet<'_>)], loops: &[&str]) -> u64 {
    let link = |name: &str, address: u64| {
        let length = [1, 0, name.len() as u8];
        message(6, &[&length, name.as_bytes(), &address.to_le_bytes()].concat())
    };
    let mut links = vec![message(2, &[&[0, 0][..], &UNDEFINED, &UNDEFINED].concat())];
    let group_of = |name: &str| name.split_once('/').map(|(group, _)| group.to_owned());
    for members in
        sets.chunk_by(|(a, _), (b, _)| group_of(a).is_some() && group_of(a) == group_of(b))
    {
        let (name, set) = members[0];
        let (name, address) = match name.split_once('/') {
            None => (name, add_data_set(file, set)),
            Some((group, _)) => {
                let inner = members.iter().map(|(name, set)| (&name[group.len() + 1..], *set));
                (group, add_group(file, &inner.collect::<Vec<_>>(), &[]))
            }
        };
        links.push(link(name, address));
    }
    let next = file.len().next_multiple_of(8) as u64;
    links.extend(loops.iter().map(|name| link(name, next)));
    add(file, &header(&links))
}

/// Aligns to eight bytes; returns the address.
fn add(file: &mut Vec<u8>, bytes: &[u8]) -> u64 {
    file.resize(file.len().next_multiple_of(8), 0);
    let address = file.len() as u64;
    file.extend(bytes);
    address
}

fn message(kind: u16, content: &[u8]) -> Vec<u8> {
    let length = content.len().next_multiple_of(8);
    let mut all = [kind.to_le_bytes(), (length as u16).to_le_bytes(), [0; 2], [0; 2]].concat();
    all.extend(content);
    all.resize(8 + length, 0);
    all
}

fn header(messages: &[Vec<u8>]) -> Vec<u8> {
    let length: usize = messages.iter().map(Vec::len).sum();
    let mut all = vec![1, 0];
    all.extend((messages.len() as u16).to_le_bytes());
    all.extend([1, 0, 0, 0]);
    all.extend((length as u32).to_le_bytes());
    all.extend([0; 4]);
    all.extend(messages.concat());
    all
}

fn add_data_set(file: &mut Vec<u8>, set: &DataSet<'_>) -> u64 {
    let rows = set.values.len() / set.width;
    let bytes = |values: &[f64]| -> Vec<u8> {
        values.iter().flat_map(|value| value.to_le_bytes()).collect()
    };
    let sides = [rows as u64, set.width as u64].map(u64::to_le_bytes).concat();
    let space = message(1, &[&[1, 2, 0, 0, 0, 0, 0, 0][..], &sides].concat());
    let double = [
        &[0x11, 0x20, 0x3f, 0, 8, 0, 0, 0, 0, 0, 64, 0, 52, 11, 0, 52][..],
        &1023_u32.to_le_bytes(),
    ];
    let double = message(3, &double.concat());
    // Incremental allocation, fill value zero.
    let fill = message(5, &[2, 3, 0, 1, 0, 0, 0, 0]);
    let layout = if set.is_chunked {
        let is_missing = |row: &usize| set.missing.get(*row).copied().unwrap_or(false);
        let chunks: Vec<(usize, u64)> = (0..rows)
            .filter(|row| !is_missing(row))
            .map(|row| {
                let own = bytes(&set.values[row * set.width..(row + 1) * set.width]);
                (row, add(file, &own))
            })
            .collect();
        let size = (8 * set.width) as u32;
        let key = |row: usize, size: u32| {
            [&size.to_le_bytes()[..], &[0; 4], &(row as u64).to_le_bytes(), &[0; 16]].concat()
        };
        let mut tree = b"TREE\x01\x00".to_vec();
        tree.extend((chunks.len() as u16).to_le_bytes());
        tree.extend([UNDEFINED, UNDEFINED].concat());
        for (row, address) in chunks {
            tree.extend(key(row, size));
            tree.extend(address.to_le_bytes());
        }
        tree.extend(key(rows, 0));
        let tree = add(file, &tree);
        let sides = [1, set.width as u32, 8].map(u32::to_le_bytes).concat();
        [&[3, 2, 3][..], &tree.to_le_bytes(), &sides].concat()
    } else {
        let content = bytes(&set.values);
        let address = add(file, &content);
        [&[3, 1][..], &address.to_le_bytes(), &(content.len() as u64).to_le_bytes()].concat()
    };
    add(file, &header(&[space, double, fill, message(8, &layout)]))
}
