//! Blobs of format 3, lifted to format 4: the same weights under the manifest that the test's own writer makes of the same model.

use std::path::{Path, PathBuf};

use motionette::Model;
use motionette::blob::Header;
use motionette_host::convert::lift::{Error, lift};
use motionette_tests::fuzz;

fn corpus(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(name)
}

fn read(path: &Path) -> Vec<u8> {
    std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Old blobs by name.
fn old() -> Vec<(String, Vec<u8>)> {
    let files = std::fs::read_dir(corpus("format3")).expect("the folder of old blobs");
    let mut old: Vec<_> = files
        .map(|file| file.expect("an entry").path())
        .map(|path| (path.file_stem().expect("a name").to_string_lossy().into_owned(), read(&path)))
        .collect();
    old.sort();
    assert!(old.len() > 3, "only {} old blobs", old.len());
    old
}

/// The weight section, found by the header's own fields.
fn weights(blob: &[u8]) -> &[u8] {
    let word = |at: usize| u32::from_le_bytes(blob[at..at + 4].try_into().expect("four bytes")) as usize;
    &blob[word(16)..word(16) + word(20)]
}

/// Makes the checksum fit.
fn repaired(mut blob: Vec<u8>) -> Vec<u8> {
    let crc = Header::checksum(&blob);
    blob[24..28].copy_from_slice(&crc.to_le_bytes());
    blob
}

#[test]
fn a_lifted_blob_is_what_the_format_says() {
    for (name, old) in old() {
        let lifted = lift(&old).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(lifted.from[0], 3, "{name}");
        assert_eq!(weights(lifted.blob.bytes()), weights(&old), "{name}");
        assert_eq!((lifted.weights, &lifted.hashes[0]), (weights(&old).len(), &lifted.hashes[1]), "{name}");
        let committed = corpus(&format!("{name}.blob"));
        if std::env::var_os("MOTIONETTE_BLESS").is_some() {
            std::fs::write(&committed, lifted.blob.bytes()).expect("written");
        }
        assert!(lifted.blob.bytes() == read(&committed), "{name}: the corpus was lifted like this");
        // The same model, written in format 4 by the tests' writer, but for its body and what depends on it: the checksum.
        let (_, tiny) = fuzz::corpus().into_iter().find(|(known, _)| *known == name).expect("a model of the corpus");
        let (mut lifted, mut written) = (lifted.blob.bytes().to_vec(), tiny.bytes().to_vec());
        for blob in [&mut lifted, &mut written] {
            // Behind the header, the card of "tiny", "MIT OR Apache-2.0", "random numbers" and "", the kind and the frame rate.
            blob[73..73 + 264].fill(0);
            blob[24..28].fill(0);
        }
        assert!(lifted == written, "{name}: the lifted manifest is another than the written one");
    }
}

/// The body of a converted blob: 22 joints, bones as long as `uniform::BONE_LENGTHS` says, along the rest pose's directions but for pelvis and
/// chest, where they are as measured.
#[test]
fn a_lifted_blob_has_the_body_that_motions_were_brought_to() {
    let blob = lift(&read(&corpus("format3/narrow.blob"))).expect("a good blob").blob;
    let model = Model::open(blob.bytes()).expect("a lifted blob opens");
    let offsets = model.skeleton().offsets();
    assert_eq!(offsets.len(), 22);
    assert_eq!(offsets[0], [0.0; 3]);
    // Hips slope, as long as before; the right knee straight down, the toes ahead, the neck up.
    for (hip, bone, side) in [(1, 0.103_074f32, 1.0), (2, 0.109_883_4, -1.0)] {
        let [x, y, z] = offsets[hip];
        assert!(
            (x.hypot(y) - bone).abs() < 1e-6 && (x * side / -y - 2.2).abs() < 1e-4 && z == 0.0,
            "{:?}",
            offsets[hip]
        );
    }
    assert_eq!((offsets[5], offsets[11]), ([0.0, -0.390_188_2, 0.0], [0.0, 0.0, 0.149_419_1]));
    assert_eq!(offsets[12], [0.0, 0.219_36, 0.0]);
}

#[test]
fn what_is_no_whole_blob_of_format_3_is_named() {
    let (_, old) = old().remove(0);
    let said = |bytes: &[u8]| lift(bytes).expect_err("a bad blob").to_string();
    for length in (4..old.len()).step_by(7) {
        let cut = lift(&old[..length]);
        assert!(matches!(cut, Err(Error::Truncated { found, .. }) if found == length), "{length}: {cut:?}");
    }
    for bit in (0..old.len() * 8).step_by(11) {
        let mut damaged = old.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        assert!(lift(&damaged).is_err(), "bit {bit}");
    }
    let version = |major: u8, minor: u8| {
        let mut other = old.clone();
        (other[4], other[6]) = (major, minor);
        said(&repaired(other))
    };
    for (major, minor, words) in [
        (4, 0, ["format 4.0", "nothing to lift"]),
        (3, 2, ["format 3.2", "newer motionette"]),
        (2, 0, ["format 2.0", "convert its checkpoint again"]),
        (5, 1, ["format 5.1", "newer motionette"]),
    ] {
        let said = version(major, minor);
        assert!(words.iter().all(|word| said.contains(word)), "{said}");
    }
    assert!(said(b"MZ").contains("needs 32 bytes"), "{}", said(b"MZ"));
    assert!(said(&[b'M'; 100]).contains("not those of a motionette blob"));
    // Bytes behind the blob do not come along.
    let longer = [&old[..], &[0xFF; 40]].concat();
    assert_eq!(lift(&longer).expect("a good blob").blob.bytes(), lift(&old).expect("a good blob").blob.bytes());
}

/// Whatever the header and the manifest, lifting answers, and what it makes opens.
#[test]
fn mutated_manifests_are_lifted_or_refused() {
    let mut counts = [0; 2];
    for (name, old) in old() {
        let end = u32::from_le_bytes(old[16..20].try_into().expect("four bytes")) as usize;
        for at in 8..end {
            for value in [0, 1, 255] {
                let mut mutant = old.clone();
                mutant[at] = value;
                match lift(&repaired(mutant)) {
                    Ok(lifted) => {
                        counts[0] += 1;
                        assert!(Model::open(lifted.blob.bytes()).is_ok(), "{name}, byte {at} = {value}");
                    }
                    Err(error) => {
                        counts[1] += 1;
                        assert!(!error.to_string().is_empty(), "{name}, byte {at} = {value}");
                    }
                }
            }
        }
    }
    assert!(counts.iter().all(|&count| count > 100), "{counts:?}");
}
