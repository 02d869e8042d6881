//! The runtime's decoder, recovery and gradients against an f64 oracle, on small random models.

use motionette::numerics::hash::Stream;
use motionette::{Bones, Error, Generator, Limits, Model, Plan, ROWS, Request};
use motionette_tests::naive;
use motionette_tests::tiny::{Shape, Tiny};

fn generate(model: &Model<'_>, request: &Request<'_>) -> (Vec<f32>, Vec<f32>) {
    let refinement = request.refinement.unwrap_or_default();
    let limits = Limits {
        tokens: model.max_tokens(),
        anchors: request.anchors.len(),
        tracked: 0,
        timeline: None,
        refinement,
        planning: None,
        rows: ROWS,
    };
    let mut arena = vec![0u8; Plan::for_request(model, &limits).expect("the limits are legal").arena_bytes + 16];
    let mut generator = Generator::new(model.clone(), &mut arena).expect("default floating point");
    let motion = generator.generate(request, &mut ()).expect("request is valid");
    (motion.joints().to_vec(), motion.u().to_vec())
}

fn shapes() -> Vec<Shape> {
    let base = Shape::default();
    vec![
        base.clone(),
        Shape { width: 36, code_width: 48, dilations: vec![9, 3, 1], ..base.clone() },
        Shape { width: 70, code_width: 5, wide: 0, dilations: vec![1], ..base.clone() },
        Shape { quantizers: 3, stages: 1, dilations: vec![2, 1, 1, 5], ..base.clone() },
        Shape { width: 3, code_width: 1, stages: 3, wide: 263, max_tokens: 9, ..base.clone() },
        // Decoders that look less far ahead than back.
        base.clone().causal(),
        Shape { dilations: vec![9, 3, 1], right: vec![1, 4, 3, 1, 0, 0, 2, 0, 1, 0, 1], ..base.clone() },
        Shape { quantizers: 2, stages: 3, dilations: vec![2], right: vec![0, 1, 1, 0, 0, 2, 1, 1, 0], ..base },
    ]
}

#[test]
fn joints_agree_with_the_oracle_for_every_shape_and_length() {
    for (seed, shape) in shapes().into_iter().enumerate() {
        let tiny = Tiny::new(shape.clone(), seed as u64 + 1);
        let model = Model::open(tiny.bytes()).expect("blob opens");
        let (codes, width) = (usize::from(shape.codes), usize::from(shape.code_width));
        let mut random = Stream::new(99 + seed as u64);
        for length in [1usize, 2, 3, 4, 5, 7, 9] {
            let quantizers = usize::from(shape.quantizers);
            let tokens: Vec<u16> = (0..length * quantizers)
                .map(|_| if random.below(8) == 0 { u16::MAX } else { random.below(codes as u32) as u16 })
                .collect();
            let mut u = vec![0.0f64; length * width];
            for (i, &token) in tokens.iter().enumerate() {
                if token != u16::MAX {
                    let code = ((i % quantizers) * codes + usize::from(token)) * width;
                    for (u, c) in u[i / quantizers * width..].iter_mut().zip(&tiny.codes[code..code + width]) {
                        *u += c;
                    }
                }
            }
            let (joints, embeddings) = generate(&model, &Request::tokens(&tokens).bones(Bones::Decoded).unrefined());
            for (got, want) in embeddings.iter().zip(&u) {
                assert!((f64::from(*got) - want).abs() < 1e-6, "{shape:?}: embedding {got} instead of {want}");
            }
            let want: Vec<f64> = naive::motion(&tiny, &u).into_iter().flatten().flatten().collect();
            assert_eq!(joints.len(), want.len(), "{shape:?}: {length} tokens");
            // int16 activations: 2^-15 a layer relative to the row's largest value, integrated over the frames.
            let worst = joints.iter().zip(&want).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max);
            assert!(worst < 2e-3, "{shape:?}: {length} tokens: joints differ by {worst} m");
            assert!(worst > 0.0, "{shape:?}: equal to the last bit is not what int16 activations give");
        }
    }
}

#[test]
fn every_bit_is_the_same_again_and_in_a_dirty_arena() {
    let tiny = Tiny::new(Shape::default(), 5);
    let model = Model::open(tiny.bytes()).unwrap();
    let tokens = [1u16, 7, 3, 10, 0, 2];
    let mut dirty = vec![0xA5u8; 1 << 20];
    let mut generator = Generator::new(model.clone(), &mut dirty).unwrap();
    let first = generator.generate(&Request::tokens(&tokens), &mut ()).unwrap().hash();
    let _ = generator.generate(&Request::tokens(&[3, 3, 3]), &mut ()).unwrap();
    assert_eq!(generator.generate(&Request::tokens(&tokens), &mut ()).unwrap().hash(), first);
    let (joints, u) = generate(&model, &Request::tokens(&tokens));
    assert_eq!(motionette::numerics::hash::motion(&u, &joints), first);
}

#[test]
fn the_arena_is_exactly_as_large_as_the_plan_says() {
    let tiny = Tiny::new(Shape::default(), 6);
    let model = Model::open(tiny.bytes()).unwrap();
    let tokens = [4u16; 12];
    let anchors = [motionette::Anchor::root(20, [0.2, 0.5, 0.3]), motionette::Anchor::joint(40, 20, [0.2, 0.5, 0.3])];
    for request in [Request::tokens(&tokens), Request::tokens(&tokens).through(&anchors)] {
        let mut words = vec![0u128; 1 << 16];
        let memory: &mut [u8] = bytemuck::cast_slice_mut(&mut words);
        let used = |memory: &mut [u8]| {
            let mut generator = Generator::new(model.clone(), memory).unwrap();
            let motion = generator.generate(&request, &mut ());
            motion.map(|motion| motion.arena_used)
        };
        let planned = Generator::new(model.clone(), memory).unwrap().plan(&request).unwrap().arena_bytes;
        assert_eq!(used(&mut memory[..planned]), Ok(planned));
        match used(&mut memory[..planned - 1]) {
            Err(Error::Arena(e)) => assert_eq!((e.needed, e.available), (planned, planned - 1)),
            other => panic!("one byte less must be refused, got {other:?}"),
        }
        // Painted: nothing behind the planned bytes is touched, and the last 16 of them are.
        memory.fill(0xC3);
        assert_eq!(used(memory), Ok(planned));
        let high_water = memory.iter().rposition(|&b| b != 0xC3).unwrap() + 1;
        assert!(high_water <= planned && high_water + 16 > planned, "high-water {high_water}, planned {planned}");
    }
}

#[test]
fn bad_requests_are_typed_errors_and_the_generator_survives() {
    let tiny = Tiny::new(Shape { max_tokens: 5, ..Shape::default() }, 7);
    let model = Model::open(tiny.bytes()).unwrap();
    let mut arena = vec![0u8; 1 << 18];
    let mut generator = Generator::new(model, &mut arena).unwrap();
    let good = generator.generate(&Request::tokens(&[1, 2]), &mut ()).unwrap().hash();
    let mut refused = |request: &Request<'_>| generator.generate(request, &mut ()).map(|_| ()).unwrap_err();
    assert_eq!(refused(&Request::tokens(&[])), Error::Tokens { found: 0, limit: 5 });
    assert_eq!(refused(&Request::tokens(&[0; 6])), Error::Tokens { found: 6, limit: 5 });
    assert_eq!(refused(&Request::tokens(&[0, 11])), Error::TokenOutOfRange { index: 1, token: 11, codes: 11 });
    assert_eq!(refused(&Request::embeddings(&[0.0; 7])), Error::Tokens { found: 7, limit: 5 });
    assert_eq!(refused(&Request::embeddings(&[0.0, 0.0, f32::NAN, 0.0, 0.0, 0.0])), Error::Embedding { index: 2 });
    assert_eq!(refused(&Request::embeddings(&[1e30, 0.0, 0.0, 0.0, 0.0, 0.0])), Error::Embedding { index: 0 });
    let beyond = [motionette::Anchor::root(8, [0.0; 3])];
    assert!(matches!(refused(&Request::tokens(&[1, 2]).through(&beyond)), Error::Anchors(_)));
    assert_eq!(generator.generate(&Request::tokens(&[1, 2]), &mut ()).unwrap().hash(), good);
}
