//! What the firmware does before anything moves: it opens the blob, proves itself by the blob's self-test, and makes the motions; with
//! the faults that hit it there.

use motionette::representation::Pose;
use motionette::{Generator, Model, Observer, Progress, Request, Stop};
use motionette_host::blob::AlignedBlob;
use std::ops::ControlFlow;

use super::faults::Kind;

/// Stages between which a generator that has overrun its deadline is asked to finish.
const DEADLINE: u32 = 200;

/// How the start went.
#[derive(Debug, Clone, Default)]
pub struct Boot {
    /// What the firmware logs.
    pub log: Vec<String>,
    /// Faults after which it went on as it should.
    pub recovered: Vec<Kind>,
}

/// Opens `blob`, after the damaged copy in the other slot if there is that fault, and runs the self-test.
///
/// # Errors
/// When the good blob cannot be opened or fails its self-test: such a robot does not move.
pub fn start(blob: &[u8], faults: &[Kind], seed: u64) -> anyhow::Result<Boot> {
    let mut boot = Boot::default();
    if faults.contains(&Kind::Corrupt) {
        let mut damaged = blob.to_vec();
        let at = motionette::numerics::hash::Stream::new(seed).below(damaged.len() as u32) as usize;
        damaged[at] ^= 0x40;
        match Model::open(AlignedBlob::new(&damaged).bytes()) {
            Ok(_) => boot.log.push(format!("slot B: damaged in byte {at}, and nobody noticed")),
            Err(error) => {
                boot.log.push(format!("slot B: refused, {error}; slot A is used"));
                boot.recovered.push(Kind::Corrupt);
            }
        }
    }
    let model = Model::open(blob)?;
    let test = [0u16; motionette::pipeline::SELF_TEST_NUMBERS];
    let tokens = &test[..usize::from(model.self_test().tokens) * model.codebooks().quantizers()];
    let plan = Generator::new(model.clone(), &mut [])?.plan(&Request::tokens(tokens))?;
    let mut arena = vec![0u128; plan.arena_bytes.div_ceil(16)];
    match Generator::new(model, bytemuck::cast_slice_mut(&mut arena))?.self_test()? {
        Some(true) => boot.log.push("self-test: the blob's motion, bit for bit".into()),
        Some(false) => anyhow::bail!("the self-test made another motion than the blob says: the robot does not move"),
        None => boot.log.push("self-test: the blob has none".into()),
    }
    Ok(boot)
}

/// Asks for `request` in half of the arena that it needs: the generator says so and nothing else happens.
///
/// # Errors
/// When the request cannot be planned at all.
pub fn in_too_small_an_arena(model: &Model<'_>, request: &Request<'_>, boot: &mut Boot) -> anyhow::Result<()> {
    let needed = Generator::new(model.clone(), &mut [])?.plan(request)?.arena_bytes;
    let mut arena = vec![0u128; needed.div_ceil(32)];
    match Generator::new(model.clone(), bytemuck::cast_slice_mut(&mut arena))?.generate(request, &mut ()) {
        Ok(_) => boot.log.push("arena: half of it was enough, against the plan".into()),
        Err(error) => {
            boot.log.push(format!("arena: {error}; the robot holds and the request gets its arena"));
            boot.recovered.push(Kind::Arena);
        }
    }
    Ok(())
}

/// An observer that asks for the best so far after some work.
struct Deadline {
    left: u32,
}

impl Observer for Deadline {
    fn progress(&mut self, _: Progress) -> ControlFlow<Stop> {
        self.left = self.left.saturating_sub(1);
        if self.left == 0 { ControlFlow::Break(Stop::Finish) } else { ControlFlow::Continue(()) }
    }
}

/// The next motion, from a generator that runs out of time: it finishes with the best it has.
///
/// # Errors
/// Whatever the generator refuses.
pub fn with_a_deadline(model: &Model<'_>, request: &Request<'_>) -> anyhow::Result<Vec<Pose>> {
    let plan = Generator::new(model.clone(), &mut [])?.plan(request)?;
    let mut arena = vec![0u128; plan.arena_bytes.div_ceil(16)];
    let mut generator = Generator::new(model.clone(), bytemuck::cast_slice_mut(&mut arena))?;
    let motion = generator.generate(request, &mut Deadline { left: DEADLINE })?;
    Ok(motion.frames().to_vec())
}
