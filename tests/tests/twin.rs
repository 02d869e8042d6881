//! The twin's requests on the desktop: they do what they are meant to cover, repeat bit for bit, and take exactly the arena
//! that is planned, as paint shows.

use std::collections::HashSet;

use motionette::{Generator, Model};
use motionette_host::blob::BlobFile;
use motionette_sim::sample_clips::SampleClips;
use motionette_sim::twin::{self, Digest};

const PAINT: u8 = 0xA5;
/// More than any of the requests takes.
const ARENA_WORDS: usize = (1 << 20) / 16;

fn model() -> BlobFile {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../models/nano.blob");
    BlobFile::open(path.as_ref()).expect("the bundled model opens")
}

/// Runs request `index` in a fresh, painted arena; returns its digest and the painted high-water, bytes.
fn painted(model: &Model<'_>, index: usize, recorded: &[&[u16]]) -> (Digest, usize) {
    let mut words = vec![0u128; ARENA_WORDS];
    let arena: &mut [u8] = bytemuck::cast_slice_mut(&mut words);
    arena.fill(PAINT);
    let mut generator = Generator::new(model.clone(), &mut *arena).expect("default floating point");
    let digest = twin::run(&mut generator, index, recorded).unwrap_or_else(|e| panic!("request {index}: {e}"));
    drop(generator);
    let touched = arena.iter().rposition(|&byte| byte != PAINT).map_or(0, |last| last + 1);
    (digest, touched)
}

#[test]
fn painted_high_water_is_what_the_request_says_it_took() {
    let file = model();
    let model = file.model().expect("opened before");
    let samples = SampleClips::built_in().expect("the clips are read");
    let recorded: Vec<&[u16]> = samples.clips.iter().map(|clip| clip.tokens.as_slice()).collect();
    let fresh: Vec<Digest> = (0..twin::REQUESTS)
        .map(|index| {
            let (digest, touched) = painted(&model, index, &recorded);
            assert_eq!(touched, digest.arena_used, "request {index}");
            digest
        })
        .collect();

    // One generator for all of them gives the same bits: nothing of a request is left behind for the next.
    let mut words = vec![0u128; ARENA_WORDS];
    let mut generator = Generator::new(model, bytemuck::cast_slice_mut(&mut words)).expect("default floating point");
    for (index, digest) in fresh.iter().enumerate() {
        assert_eq!(twin::run(&mut generator, index, &recorded).as_ref(), Ok(digest), "request {index}");
    }

    // What the requests are there to cover.
    let lengths: HashSet<usize> = fresh.iter().map(|digest| digest.numbers).collect();
    assert!(lengths.contains(&1) && lengths.contains(&49) && lengths.len() > 15, "{lengths:?}");
    let hashes: HashSet<u64> = fresh.iter().map(|digest| digest.joints).collect();
    assert_eq!(hashes.len(), twin::REQUESTS, "every request makes another motion");
    let mut better = 0;
    for (index, digest) in fresh.iter().enumerate().filter(|(_, digest)| digest.anchors > 0) {
        let (before, after) = (f32::from_bits(digest.before), f32::from_bits(digest.after));
        assert!(before > 0.05 && after <= before, "request {index}: {before} m before, {after} m after");
        better += usize::from(after < 0.95 * before);
    }
    // A few evaluations are not enough for all of them.
    assert!(better >= twin::REQUESTS / 2, "only {better} requests came closer to their anchors");
    let standard = &fresh[twin::STANDARD];
    assert_eq!((standard.numbers, standard.anchors, standard.evaluations), (49, 4, 0));
    let (before, after) = (f32::from_bits(standard.before), f32::from_bits(standard.after));
    assert!(after < 0.5 * before, "{before} m before, {after} m after");
}

#[test]
fn the_hash_of_a_run_depends_on_every_part_of_every_request() {
    let digest = Digest {
        numbers: 1,
        anchors: 0,
        evaluations: 0,
        gradients: 0,
        before: 0,
        after: 0,
        arena_used: 0,
        tokens: 1,
        u: 2,
        joints: 3,
    };
    let run = [digest; 3];
    let hash = twin::combine(&run);
    for at in 0..run.len() {
        for change in [|d: &mut Digest| d.tokens ^= 1, |d: &mut Digest| d.u ^= 1 << 63, |d: &mut Digest| d.joints ^= 1]
        {
            let mut other = run;
            change(&mut other[at]);
            assert_ne!(twin::combine(&other), hash, "request {at}");
        }
    }
    assert_ne!(twin::combine(&run[..2]), hash);
}
