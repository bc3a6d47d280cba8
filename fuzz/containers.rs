//! Containers around content: zip archives and TFRecord frames.

/// Checksum with this reversed polynomial.
fn crc(polynomial: u32, bytes: &[u8]) -> u32 {
    let step = |crc: u32| if crc & 1 == 1 { crc >> 1 ^ polynomial } else { crc >> 1 };
    !bytes.iter().fold(!0, |crc, byte| (0..8).fold(crc ^ u32::from(*byte), |crc, _| step(crc)))
}

/// A zip archive of uncompressed files (APPNOTE.TXT 6.3.10).
pub fn zip_archive(files: &[(&str, &[u8])]) -> Vec<u8> {
    let (mut all, mut directory) = (Vec::new(), Vec::new());
    for (name, content) in files {
        let offset = all.len() as u32;
        let mut common = vec![20, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        common.extend(crc(0xedb8_8320, content).to_le_bytes());
        common.extend(
            [content.len() as u32, content.len() as u32].iter().flat_map(|n| n.to_le_bytes()),
        );
        common.extend((name.len() as u16).to_le_bytes());
        common.extend([0, 0]);
        all.extend([b"PK\x03\x04", common.as_slice(), name.as_bytes(), content].concat());
        directory.extend([b"PK\x01\x02\x14\x00", common.as_slice(), &[0; 10]].concat());
        directory.extend(offset.to_le_bytes());
        directory.extend(name.as_bytes());
    }
    let (start, size, count) = (all.len() as u32, directory.len() as u32, files.len() as u16);
    all.extend(directory);
    all.extend(b"PK\x05\x06\0\0\0\0");
    all.extend([count, count].iter().flat_map(|n| n.to_le_bytes()));
    all.extend([size, start].iter().flat_map(|n| n.to_le_bytes()));
    all.extend([0, 0]);
    all
}

/// A record in the frame of TFRecord, with masked CRC-32C checksums.
pub fn tfrecord_frame(record: &[u8]) -> Vec<u8> {
    let masked = |bytes: &[u8]| {
        crc(0x82f6_3b78, bytes).rotate_right(15).wrapping_add(0xa282_ead8).to_le_bytes()
    };
    let length = (record.len() as u64).to_le_bytes();
    [&length, masked(&length).as_slice(), record, &masked(record)].concat()
}

/// A workbook of Excel with one sheet.
#[allow(dead_code, reason = "not every program that loads this file makes workbooks")]
pub fn workbook(strings: &[u8], sheet: &[u8]) -> Vec<u8> {
    let types = br#"<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types"/>"#;
    let relations = concat!(
        r#"<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">"#,
        r#"<Relationship Id="rId1" Type="http://schemas.openxmlformats.org/officeDocument/2006/relationships/worksheet" "#,
        r#"Target="worksheets/sheet1.xml"/></Relationships>"#
    );
    let book = concat!(
        r#"<workbook xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main" "#,
        r#"xmlns:r="http://schemas.openxmlformats.org/officeDocument/2006/relationships">"#,
        r#"<sheets><sheet name="run" sheetId="1" r:id="rId1"/></sheets></workbook>"#
    );
    zip_archive(&[
        ("[Content_Types].xml", types.as_slice()),
        ("xl/_rels/workbook.xml.rels", relations.as_bytes()),
        ("xl/workbook.xml", book.as_bytes()),
        ("xl/sharedStrings.xml", strings),
        ("xl/worksheets/sheet1.xml", sheet),
    ])
}
