//! Two slots in flash: what power loss and broken bits leave.

mod common;

use common::{BLOB, Flash, OTHER, crc, flash_with as flash_of};
use motionette_link::message::{BlobFault, FlashFault, UpdateFault};
use motionette_link::update::{Layout, Slot, Storage, Store};

/// The whole way of a blob, to the first failure.
fn update(store: &mut Store, flash: &mut Flash, blob: &[u8], piece: usize) -> Result<(), UpdateFault> {
    store.begin(flash, blob.len() as u32, crc(blob))?;
    for (index, bytes) in blob.chunks(piece).enumerate() {
        store.write(flash, (index * piece) as u32, bytes)?;
    }
    store.commit(flash).map(drop)
}

/// A flash in which `blobs` were made active one after the other.
fn flash_with(blobs: &[&[u8]]) -> (Store, Flash) {
    let mut flash = Flash::default();
    let mut store = Store::open(&flash);
    for blob in blobs {
        update(&mut store, &mut flash, blob, 240).unwrap();
    }
    (store, flash)
}

#[test]
fn slots_take_turns_and_the_newest_wins() {
    let (store, flash) = flash_with(&[]);
    assert_eq!((store.active(), store.bytes(&flash)), (None, None));
    let (mut store, mut flash) = flash_with(&[BLOB]);
    for turn in 0..5 {
        let blob = [OTHER, BLOB][turn % 2];
        let before = store.slot().unwrap();
        update(&mut store, &mut flash, blob, [1, 16, 37, 240, 5000][turn]).unwrap();
        assert_eq!(store.slot(), Some(before.other()));
        let again = Store::open(&flash);
        assert_eq!((again.active(), again.bytes(&flash)), (store.active(), Some(blob)));
    }
    assert_eq!(store.active().unwrap().sequence, 6);
    // Model::open wants 16 bytes.
    assert!((store.bytes(&flash).unwrap().as_ptr() as usize).is_multiple_of(16));
}

/// Power is lost at every single flash operation, in its middle; whatever was written until then stays. The old blob is
/// active afterwards, or the new one if its header was complete, and the next update succeeds.
#[test]
fn power_loss_at_any_operation_leaves_a_whole_blob() {
    for first in [&[BLOB][..], &[OTHER, BLOB]] {
        let (_, flash) = flash_with(first);
        let old = *first.last().unwrap();
        let operations = {
            let mut flash = flash.clone();
            let before = flash.operations;
            update(&mut Store::open(&flash), &mut flash, OTHER, 240).unwrap();
            flash.operations - before
        };
        assert!(operations > 50, "{operations}");
        for cut in 0..operations {
            let mut broken = flash.clone();
            broken.power_for = broken.operations + cut;
            let mut store = Store::open(&broken);
            let error = update(&mut store, &mut broken, OTHER, 240).unwrap_err();
            assert_eq!(error, UpdateFault::Flash(FlashFault::Device), "cut {cut}");
            // While there is power left, and after it came back.
            assert_eq!(store.bytes(&broken), Some(old), "cut {cut}");
            broken.power_for = usize::MAX;
            let mut store = Store::open(&broken);
            assert_eq!(store.bytes(&broken), Some(old), "cut {cut}");
            update(&mut store, &mut broken, OTHER, 240).unwrap();
            assert_eq!(Store::open(&broken).bytes(&broken), Some(OTHER), "cut {cut}");
        }
    }
}

/// The transfer ends after any number of bytes, without a commit or with one: the old blob stays.
#[test]
fn a_broken_transfer_leaves_the_old_blob() {
    let (_, flash) = flash_with(&[BLOB]);
    for count in (0..OTHER.len()).step_by(61).chain([OTHER.len() - 1]) {
        let mut flash = flash.clone();
        let mut store = Store::open(&flash);
        store.begin(&mut flash, OTHER.len() as u32, crc(OTHER)).unwrap();
        assert_eq!(store.write(&mut flash, 0, &OTHER[..count]), Ok(count as u32));
        let incomplete = UpdateFault::Incomplete { next: count as u32, length: OTHER.len() as u32 };
        assert_eq!(store.commit(&mut flash), Err(incomplete));
        assert_eq!(Store::open(&flash).bytes(&flash), Some(BLOB));
        store.abort();
        assert_eq!(store.commit(&mut flash), Err(UpdateFault::NoTransfer));
        assert_eq!(store.write(&mut flash, 0, &[1]), Err(UpdateFault::NoTransfer));
        assert_eq!(Store::open(&flash).bytes(&flash), Some(BLOB));
    }
}

/// Every byte of the newest slot's header and a sample of its blob may rot: the older blob is active then.
#[test]
fn damage_in_the_newest_slot_brings_the_older_one_back() {
    let (store, flash) = flash_with(&[BLOB, OTHER]);
    assert_eq!(store.slot(), Some(Slot::B));
    let base = flash.layout().offsets[1] as usize;
    for at in (0..24).chain((1024..1024 + OTHER.len()).step_by(97)) {
        let mut flash = flash.clone();
        flash.damage(base + at);
        let mut store = Store::open(&flash);
        assert_eq!(store.bytes(&flash), Some(BLOB), "byte {at}");
        update(&mut store, &mut flash, OTHER, 240).unwrap();
        assert_eq!(Store::open(&flash).bytes(&flash), Some(OTHER), "byte {at}");
    }
}

/// A write that the flash swallows is found by the verification.
#[test]
fn flash_that_does_not_keep_what_it_is_given_is_found_out() {
    let (mut store, mut flash) = flash_with(&[BLOB]);
    store.begin(&mut flash, OTHER.len() as u32, crc(OTHER)).unwrap();
    store.write(&mut flash, 0, OTHER).unwrap();
    flash.damage(flash.layout().offsets[1] as usize + 1024 + 700);
    assert!(matches!(store.commit(&mut flash), Err(UpdateFault::Checksum { .. })));
    assert_eq!((store.transfer(), Store::open(&flash).bytes(&flash)), (None, Some(BLOB)));
}

/// A blob that is whole but of another format, `offset` versions away.
fn of_format(blob: &[u8], offset: i8) -> (Vec<u8>, UpdateFault) {
    let mut other = blob.to_vec();
    other[4] = other[4].wrapping_add_signed(offset);
    let (found, supported) = (u16::from(other[4]), u16::from(blob[4]));
    (other, UpdateFault::Model(BlobFault::Version { found, supported }))
}

/// What an older or a newer firmware has left is reported, and stays as long as there is another place.
#[test]
fn blobs_that_this_firmware_does_not_read() {
    let (older, why) = of_format(BLOB, -1);
    let (newer, why_newer) = of_format(OTHER, 1);
    // Both slots: the newest is reported, the other one overwritten.
    for (blobs, slot, why) in [([&older[..], &newer], 1, why_newer), ([&newer, &older], 1, why)] {
        let mut flash = flash_of(&blobs);
        let mut store = Store::open(&flash);
        let refused = store.refused().unwrap();
        assert_eq!((store.active(), refused.why, refused.blob.slot, refused.blob.sequence), (None, why, slot, 2));
        update(&mut store, &mut flash, OTHER, 240).unwrap();
        let active = store.active().unwrap();
        assert_eq!((active.slot, active.sequence, store.refused()), (0, 3, None));
        assert_eq!(Store::open(&flash).active(), Some(active));
        assert_eq!(flash.mapped(Slot::B)[1024..][..blobs[1].len()], *blobs[1]);
    }
    // An older one that can be used is used; the newer one makes way.
    let mut flash = flash_of(&[OTHER, &older]);
    let mut store = Store::open(&flash);
    assert_eq!((store.bytes(&flash), store.refused().map(|r| r.why)), (Some(OTHER), Some(why)));
    store.begin(&mut flash, 100, 0).unwrap();
    assert_eq!((store.refused(), store.bytes(&flash)), (None, Some(OTHER)));
    // A newer one that can be used leaves nothing to say.
    let store = Store::open(&flash_of(&[&older, OTHER]));
    assert_eq!((store.active().map(|blob| blob.slot), store.refused()), (Some(1), None));
}

#[test]
fn a_blob_may_not_grow_beyond_its_length() {
    let (mut store, mut flash) = flash_with(&[]);
    store.begin(&mut flash, 10, 0).unwrap();
    assert_eq!(store.write(&mut flash, 0, &[1; 8]), Ok(8));
    assert_eq!(store.write(&mut flash, 8, &[1; 3]), Err(UpdateFault::Length { length: 11, limit: 10 }));
    assert_eq!(store.write(&mut flash, 8, &[1; 2]), Ok(10));
    assert_eq!(store.write(&mut flash, u32::MAX, &[1; 2]), Ok(10));
}

#[test]
fn slots_that_do_not_fit_the_flash_are_refused() {
    struct Misplaced(Flash, Layout);
    impl Storage for Misplaced {
        type Flash = Flash;
        fn flash(&mut self) -> &mut Flash {
            &mut self.0
        }
        fn layout(&self) -> Layout {
            self.1
        }
        fn mapped(&self, slot: Slot) -> &[u8] {
            self.0.mapped(slot)
        }
    }
    for (offsets, length) in [
        ([0, 512], 4096),
        ([0, 2048], 4096),
        ([2048, 0], 4096),
        ([0, 32 * 1024], 4096),
        ([0, 4096], 1024),
        ([0, 4096], 1500),
        ([0, u32::MAX - 1023], 4096),
    ] {
        let mut storage = Misplaced(Flash::default(), Layout { offsets, length });
        let mut store = Store::open(&storage);
        assert_eq!(store.begin(&mut storage, 100, 0), Err(UpdateFault::Layout), "{offsets:?} {length}");
        assert_eq!(storage.0.operations, 0);
    }
}
