//! `motionette-board`: what the Pico 2's image takes of flash and RAM, whether it fits, and how long a motion takes there, estimated.

use std::path::PathBuf;
use std::process::ExitCode;
use std::str::FromStr;

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
/// Bytes of a blob that fits a slot, which begins with a sector of 4 KiB that says what lies in it.
const SLOT: usize = Layout::PICO2.length as usize - 4096;
/// Stack that the runtime needs with a link interrupt and a servo tick on top of it (16 KiB painted in the emulator, and as much again).
const STACK: u64 = 32 * 1024;
/// Bytes that a blob and all of the runtime's code may take together: 2.2 MiB.
const CODE_AND_BLOB: u64 = 11 * (1 << 20) / 5;
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
    /// A blob that must fit a slot beside the firmware.
    #[arg(long, value_name = "BLOB")]
    slot: Option<PathBuf>,
    /// A check image of some features, and the bytes that its code may take.
    #[arg(long, value_name = "FEATURES=BYTES=IMAGE")]
    code: Vec<Code>,
    /// Print one machine-readable object on the last line.
    #[arg(long)]
    json: bool,
}

/// What a firmware with some of the runtime's features links.
#[derive(Debug, Clone)]
struct Code {
    features: String,
    budget: u64,
    image: PathBuf,
}

impl FromStr for Code {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let mut parts = text.splitn(3, '=');
        let (Some(features), Some(budget), Some(image)) = (parts.next(), parts.next(), parts.next()) else {
            return Err(format!("`{text}` is not FEATURES=BYTES=IMAGE"));
        };
        let budget = budget.parse().map_err(|e| format!("`{budget}` bytes: {e}"))?;
        Ok(Code { features: features.to_owned(), budget, image: image.into() })
    }
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
    let request = request.through(&early);
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
    say(&format!("preset               {motion} s of motion, {} planner steps, exact anchors", preset.steps));
    say(&format!(
        "a motion             about {seconds:.1} s at 150 MHz: {:.0} M instructions of {CYCLES} cycles (assumed), {:.0} MB of weights \
         through serial flash",
        instructions / 1e6,
        fetched / 1e6
    ));
    let (mut too_large, mut largest) = (Vec::new(), None);
    for Code { features, budget, image } in &cli.code {
        let elf = std::fs::read(image).with_context(|| format!("cannot read {}", image.display()))?;
        let bytes = image::text_bytes(&elf)?;
        say(&format!("runtime code, M4F    {bytes:>6} of {budget:>6} bytes: {features}"));
        largest = largest.max(Some(bytes));
        if bytes > *budget {
            too_large.push(format!("{features}: {bytes} bytes, {budget} are the budget"));
        }
    }
    if let Some(most) = largest {
        let (all, blob) = (most + model.bytes().len() as u64, cli.blob.display());
        say(&format!("code and blob        {all} of {CODE_AND_BLOB} bytes: {blob}"));
        ensure!(all <= CODE_AND_BLOB, "code and {blob} take {all} bytes, {CODE_AND_BLOB} are the budget");
    }
    if let Some(path) = &cli.slot {
        let (bytes, room) = (BlobFile::open(path)?.model()?.bytes().len(), SLOT);
        say(&format!("a slot for a blob    {bytes} of {room} bytes: {}", path.display()));
        ensure!(bytes <= room, "{} does not fit a slot: {bytes} bytes, {room} are there", path.display());
    }
    ensure!(too_large.is_empty(), "the runtime's code is too large: {}", too_large.join("; "));
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
