//! Content sniffing.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

use std::path::Path;

use import::{Format, ImportError, Options, import, input_bytes, sniff};

fn sniff_content(name: &str, content: &[u8]) -> Result<Format, ImportError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    std::fs::write(&path, content).unwrap();
    sniff(&path)
}

#[test]
fn the_format_follows_from_the_content_not_the_name() {
    for magic in [
        [0xD4, 0xC3, 0xB2, 0xA1],
        [0xA1, 0xB2, 0xC3, 0xD4],
        [0x4D, 0x3C, 0xB2, 0xA1],
        [0xA1, 0xB2, 0x3C, 0x4D],
        [0x0A, 0x0D, 0x0D, 0x0A],
    ] {
        assert_eq!(sniff_content("anything", &magic).unwrap(), Format::Pcap);
    }
    assert_eq!(sniff_content("anything", &[0x9C, 0xAD].repeat(4)).unwrap(), Format::Nclt);
    assert_eq!(sniff_content("groundtruth_2013-01-10.csv", b"1,2,3").unwrap(), Format::Nclt);
    let carmen = "# a comment\n".repeat(1000) + "PARAM x 1\nODOM 0 0 0 0 0 0 1.0 h 0\n";
    assert_eq!(sniff_content("anything", carmen.as_bytes()).unwrap(), Format::Carmen);
}

#[test]
fn an_unknown_format_is_described_with_a_remedy() {
    let error = |name: &str, content: &[u8]| sniff_content(name, content).unwrap_err().to_string();
    assert!(error("a.mcap", b"\x89MCAP0\r\n").contains("found an MCAP file (it needs no import)"));
    assert!(error("a.gz", &[0x1F, 0x8B, 8]).contains("gzip data (unpack it first)"));
    assert!(error("a", b"").contains("found an empty file"));
    assert!(error("a.txt", b"Dear diary\n").contains("text that starts with `Dear diary`"));
    assert!(error("a.bin", &[0xFF, 0xFE, 0]).contains("starts with the bytes [ff, fe, 00]"));
    assert!(error("a", b"x").contains("expected a libpcap or pcapng capture, a ROS 1 bag"));

    let folder = tempfile::tempdir().unwrap();
    assert!(sniff(folder.path()).unwrap_err().to_string().contains("an empty folder"));
    std::fs::write(folder.path().join("photo.jpg"), b"").unwrap();
    assert!(sniff(folder.path()).unwrap_err().to_string().contains("a folder with photo.jpg"));
    let missing = sniff(Path::new("no/such/file")).unwrap_err().to_string();
    assert_eq!(missing, "cannot read no/such/file");
}

#[test]
fn inputs_of_two_formats_are_an_error_and_each_file_is_read_once() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, content: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, content).unwrap();
        path
    };
    let carmen = write("a.log", b"ODOM 0 0 0 0 0 0 1.0 h 0\n");
    let wheels = write("wheels.csv", b"1,2,3\n");
    let out = || std::io::Cursor::new(Vec::new());
    let both = [carmen.clone(), wheels.clone()];
    let error = import(&both, &Options::default(), out(), |_| {}).unwrap_err().to_string();
    assert!(error.contains("is a CARMEN log") && error.contains("is NCLT data"), "{error}");
    assert!(matches!(import(&[], &Options::default(), out(), |_| {}), Err(ImportError::NoInput)));

    // The file is given twice: directly and as a part of the folder.
    let seen = std::cell::Cell::new(0);
    let paths = [folder.path().to_owned(), wheels];
    let imported = import(&paths, &Options::default(), out(), |n| seen.set(n)).unwrap();
    assert_eq!(imported.topics[0].n_messages, 1);
    assert_eq!(seen.get(), 6);
    assert_eq!(input_bytes(&paths).unwrap(), 6);
    assert_eq!(input_bytes(&[carmen]).unwrap(), 25);
}
