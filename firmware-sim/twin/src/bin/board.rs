//! `motionette-board`: what the Pico 2's image takes of flash and RAM, whether it fits, and how long a motion takes there, estimated.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result, ensure};
use clap::Parser;
use motionette::codec::vq::decoder::ChunkShape;
use motionette::{Generator, Request};
use motionette_host::blob::BlobFile;
use motionette_host::console::{self, say};
use motionette_link::Preset;
use motionette_link::update::Layout;
use motionette_sim::report::INSTRUCTIONS_PER_MAC;
use motionette_twin::image;
use serde_json::json;

/// Flash that `memory.x` gives the firmware, and RAM.
const FLASH: u64 = Layout::PICO2.offsets[0] as u64;
const RAM: u64 = 512 * 1024;
/// Stack that the runtime needs with a link interrupt and a servo tick on top of it (16 KiB painted in the emulator, and as much again).
const STACK: u64 = 32 * 1024;
/// Bytes that the runtime's code may take on a Cortex-M4F, whichever compiler builds it; with playback.
const CODE: u64 = 164 * 1024;
const CODE_WITH_PLAYBACK: u64 = 192 * 1024;
/// Hertz.
const CLOCK: f64 = 150e6;
/// Cycles an instruction, assumed: code and weights come through a cache of 16 KiB in front of serial flash.
const CYCLES: f64 = 1.4;
/// Bytes a second of that flash: four bits at 75 MHz.
const FLASH_BANDWIDTH: f64 = 37.5e6;

/// Sizes of a board's image, and the time that its preset's motion takes, estimated.
#[derive(Debug, Parser)]
struct Cli {
    /// The image, ELF.
    image: PathBuf,
    /// The model.
    blob: PathBuf,
    /// The Cortex-M4F check image without playback, and with it.
    #[arg(requires = "gate")]
    check: Option<PathBuf>,
    /// See `check`.
    gate: Option<PathBuf>,
    /// Print one machine-readable object on the last line.
    #[arg(long)]
    json: bool,
}

fn main() -> ExitCode {
    console::conclude(run(&Cli::parse()))
}

fn run(cli: &Cli) -> Result<()> {
    let elf = std::fs::read(&cli.image).with_context(|| format!("cannot read {}", cli.image.display()))?;
    let (flash, ram) = (image::flash_bytes(&elf)?, image::static_ram_bytes(&elf)?);
    let blob = BlobFile::open(&cli.blob)?;
    let model = blob.model()?;
    let preset = Preset::PICO2;
    let anchors = motionette_sim::standard_request::anchors();
    let anchors = anchors.by_frame(model.frame_rate())?;
    // The same places, in the time that there is.
    let longest = model.max_tokens() * model.frames_per_token();
    let earlier = |frame: u16| (usize::from(frame) * usize::from(preset.frames) / longest) as u16;
    let early: Vec<_> =
        anchors.iter().map(|anchor| motionette::Anchor { frame: earlier(anchor.frame), ..*anchor }).collect();
    let request = Request::text(motionette_sim::standard_request::PROMPT).frames(preset.frames).steps(preset.steps);
    let config = motionette::refining::Config { evaluations: preset.evaluations, ..Default::default() };
    let request = request.through(&early).refined(config);
    let plan = Generator::new(model.clone(), &mut [])?.plan(&request)?;
    let instructions = plan.macs as f64 * INSTRUCTIONS_PER_MAC;
    let decoder = plan.macs - plan.planning_macs;
    // Weights are fetched once for so many rows: blocks of the planner are full but for the last, and a token is a row of the decoder or more.
    let tokens = usize::from(preset.frames).div_ceil(model.frames_per_token());
    let each = |rows: usize, most: usize| rows as f64 / rows.div_ceil(most) as f64;
    let chunk = ChunkShape::new(tokens, preset.rows).tokens;
    let fetched = plan.planning_macs as f64 / each(1 + tokens, preset.rows) + decoder as f64 / each(tokens, chunk);
    let seconds = instructions * CYCLES / CLOCK + fetched / FLASH_BANDWIDTH;
    let motion = f64::from(preset.frames) / f64::from(model.frame_rate());
    say(&format!(
        "flash                {flash} of {FLASH} bytes, and two slots of {} bytes for blobs",
        Layout::PICO2.length
    ));
    say(&format!("RAM                  {ram} of {RAM} bytes, {} left for the stack", RAM.saturating_sub(ram)));
    say(&format!(
        "preset               {motion} s of motion, {} planner steps, {} decoder evaluations",
        preset.steps, preset.evaluations
    ));
    say(&format!(
        "a motion             about {seconds:.1} s at 150 MHz: {:.0} M instructions of {CYCLES} cycles (assumed), {:.0} MB of weights \
         through serial flash",
        instructions / 1e6,
        fetched / 1e6
    ));
    if let (Some(check), Some(gate)) = (&cli.check, &cli.gate) {
        let bytes = |path: &PathBuf| -> Result<u64> {
            image::text_bytes(&std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?)
        };
        let (without, with) = (bytes(check)?, bytes(gate)?);
        say(&format!("runtime code, M4F    {without} of {CODE} bytes, {with} of {CODE_WITH_PLAYBACK} with playback"));
        ensure!(without <= CODE, "the runtime's code has {without} bytes, {CODE} are its budget");
        ensure!(
            with <= CODE_WITH_PLAYBACK,
            "with playback its code has {with} bytes, {CODE_WITH_PLAYBACK} are the budget"
        );
    }
    if cli.json {
        let object = json!({
            "flash_bytes": flash, "flash_limit": FLASH, "ram_bytes": ram, "ram_limit": RAM, "stack_left": RAM.saturating_sub(ram),
            "motion_seconds": motion, "estimated_seconds": seconds, "instructions": instructions, "arena_bytes": plan.arena_bytes,
        });
        say(&object.to_string());
    }
    ensure!(flash <= FLASH, "the firmware does not fit: {flash} bytes of flash, {FLASH} are there");
    ensure!(ram + STACK <= RAM, "too little is left for the stack: {ram} bytes of RAM are taken, {RAM} are there");
    Ok(())
}
