//! Validation of anchors: every kind of bad list, order, duplicates, conflicts.

use motionette::request::conditions::{Anchor, AnchorError, AnchorSet, FARTHEST, Family, MAX_ANCHORS};

const FRAMES: usize = 100;

fn set(anchors: &[Anchor]) -> Result<AnchorSet, AnchorError> {
    AnchorSet::new(anchors, FRAMES)
}

#[test]
fn sorts_by_frame_and_joint_and_remembers_the_order_given() {
    let anchors = [
        Anchor::joint(40, 21, [0.1, 1.0, 0.2]),
        Anchor::root(7, [0.0, 0.9, 0.5]),
        Anchor::joint(40, 15, [0.3, 1.6, 0.4]),
        Anchor::planar_root(99, [1.0, 2.0]),
    ];
    let set = set(&anchors).unwrap();
    let order: Vec<_> = set.iter().map(|a| (a.frame, a.joint, a.index)).collect();
    assert_eq!(order, [(7, 0, 1), (40, 15, 2), (40, 21, 0), (99, 0, 3)]);
    assert_eq!(set.last_frame(), Some(99));
    assert_eq!(set.iter().last().map(|a| a.family), Some(Family::PlanarRoot));
}

#[test]
fn every_permutation_gives_the_same_set() {
    let anchors = [
        Anchor::root(3, [0.0, 0.9, 0.1]),
        Anchor::joint(3, 20, [0.4, 1.0, 0.1]),
        Anchor::joint(90, 7, [0.1, 0.1, 2.0]),
        Anchor::planar_root(50, [0.0, 1.0]),
    ];
    let expected: Vec<_> = set(&anchors).unwrap().iter().map(|a| (a.frame, a.joint, a.target)).collect();
    let mut order = [0usize, 1, 2, 3];
    let mut permutations = 0;
    // Heap's algorithm.
    let mut counters = [0; 4];
    let mut i = 0;
    loop {
        let list: Vec<_> = order.iter().map(|&k| anchors[k]).collect();
        let sorted: Vec<_> = set(&list).unwrap().iter().map(|a| (a.frame, a.joint, a.target)).collect();
        assert_eq!(sorted, expected, "order {order:?}");
        permutations += 1;
        while i < 4 && counters[i] >= i {
            counters[i] = 0;
            i += 1;
        }
        if i == 4 {
            break;
        }
        order.swap(if i % 2 == 0 { 0 } else { counters[i] }, i);
        counters[i] += 1;
        i = 1;
    }
    assert_eq!(permutations, 24);
}

#[test]
fn duplicates_count_once() {
    let wrist = Anchor::joint(10, 20, [0.3, 1.1, 0.2]);
    let root = Anchor::root(10, [0.5, 0.9, 0.25]);
    let list = [wrist, root, wrist, Anchor::planar_root(10, [0.5, 0.25]), Anchor::joint(10, 0, [0.5, 0.9, 0.25])];
    let merged = set(&list).unwrap();
    assert_eq!(merged.len(), 2);
    assert_eq!(merged.iter().map(|a| a.family).collect::<Vec<_>>(), [Family::Root3d, Family::BodyPoint]);

    // A Root-3D anchor takes the place of the Planar-root anchor it completes.
    let completed = set(&[Anchor::planar_root(10, [0.5, 0.25]), root]).unwrap();
    assert_eq!(completed.len(), 1);
    assert_eq!(completed.iter().map(|a| (a.family, a.target)).next(), Some((Family::Root3d, [0.5, 0.9, 0.25])));

    let many = vec![wrist; 10_000];
    assert_eq!(set(&many).unwrap().len(), 1);
}

#[test]
fn the_family_of_one_place_does_not_depend_on_the_order() {
    let (planar, joint, root) = (
        Anchor::planar_root(10, [0.5, 0.25]),
        Anchor::joint(10, 0, [0.5, 0.9, 0.25]),
        Anchor::root(10, [0.5, 0.9, 0.25]),
    );
    let family = |list: &[Anchor]| {
        let set = set(list).unwrap();
        assert_eq!(set.len(), 1);
        set.iter().map(|a| (a.family, a.target)).next().unwrap()
    };
    let (body, space) = ((Family::BodyPoint, [0.5, 0.9, 0.25]), (Family::Root3d, [0.5, 0.9, 0.25]));
    for (list, expected) in
        [([joint, root, root], space), ([planar, root, planar], space), ([planar, joint, joint], body)]
    {
        let mut order = list;
        for swap in [[0, 1], [1, 2], [0, 1], [1, 2], [0, 1], [1, 2]] {
            let [a, b] = swap;
            order.swap(a, b);
            assert_eq!(family(&order), expected, "{order:?}");
        }
    }
    for order in [[planar, joint, root], [root, joint, planar], [joint, planar, root], [joint, root, planar]] {
        assert_eq!(family(&order), space);
    }
}

#[test]
fn refuses_what_cannot_be_met_and_names_it() {
    let good = Anchor::root(0, [0.0, 0.9, 0.0]);
    let cases: [(Anchor, AnchorError); 7] = [
        (Anchor::root(100, [0.0; 3]), AnchorError::FrameOutOfRange { index: 1, frame: 100, frames: FRAMES }),
        (Anchor::joint(5, 22, [0.0; 3]), AnchorError::JointOutOfRange { index: 1, joint: 22, joints: 22 }),
        (Anchor::joint(5, 255, [0.0; 3]), AnchorError::JointOutOfRange { index: 1, joint: 255, joints: 22 }),
        (Anchor::root(5, [0.0, f32::NAN, 0.0]), AnchorError::NotFinite { index: 1 }),
        (Anchor::planar_root(5, [f32::INFINITY, 0.0]), AnchorError::NotFinite { index: 1 }),
        (Anchor::joint(5, 3, [0.0, 0.0, -1e30]), AnchorError::TooFar { index: 1, limit: FARTHEST }),
        (Anchor::joint(0, 0, [0.0, 0.9, 0.001]), AnchorError::Conflict { first: 0, second: 1 }),
    ];
    for (bad, error) in cases {
        assert_eq!(set(&[good, bad]).unwrap_err(), error);
        assert!(!error.to_string().is_empty());
    }
    let conflict = [good, Anchor::planar_root(0, [0.0, 0.5])];
    assert_eq!(set(&conflict).unwrap_err(), AnchorError::Conflict { first: 0, second: 1 });
    assert_eq!(AnchorSet::new(&[good], 0).unwrap_err(), AnchorError::FrameOutOfRange { index: 0, frame: 0, frames: 0 });
}

#[test]
fn limits_the_number_of_distinct_anchors() {
    let fill = |count: usize| (0..count).map(|i| Anchor::root(i as u16, [0.0, 0.9, 0.0])).collect::<Vec<_>>();
    assert_eq!(set(&fill(MAX_ANCHORS)).unwrap().len(), MAX_ANCHORS);
    let error = set(&fill(MAX_ANCHORS + 1)).unwrap_err();
    assert_eq!(error, AnchorError::TooMany { anchors: MAX_ANCHORS + 1, limit: MAX_ANCHORS });
    // Duplicates do not use up the limit.
    let mut list = fill(MAX_ANCHORS);
    list.extend(fill(MAX_ANCHORS));
    assert_eq!(set(&list).unwrap().len(), MAX_ANCHORS);
}

#[test]
fn the_empty_list_is_an_empty_set() {
    let set = set(&[]).unwrap();
    assert!(set.is_empty());
    assert_eq!(set.iter().count(), 0);
    assert_eq!(set.last_frame(), None);
}
