//! Runs the seeded requests on the desktop and the bare-metal images in QEMU, decodes their defmt output, and compares every
//! bit. Started by `cargo xtask twin`, which builds the images first.

use std::{
    fs,
    path::{Path, PathBuf},
    process::ExitCode,
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context, Result, bail, ensure};
use clap::Parser;
use motionette::Generator;
use motionette_host::blob::BlobFile;
use motionette_host::console::{self, remark, say};
use motionette_sim::{
    sample_clips::SampleClips,
    twin::{self, Digest},
};
use motionette_twin::{
    image, log,
    qemu::{self, M4, M7, M33, M55, Machine},
    report::{self, Report},
};
use serde_json::json;

/// Compares the desktop with emulated Cortex-M cores, bit for bit.
#[derive(Parser)]
struct Options {
    /// Twin image for the Cortex-M4F and M7.
    #[arg(long, value_name = "ELF")]
    image: PathBuf,
    /// Check image for the Cortex-M4F: code size, panic sites.
    #[arg(long, value_name = "ELF")]
    check: PathBuf,
    /// Twin image for the Cortex-M33.
    #[arg(long, value_name = "ELF")]
    m33_image: PathBuf,
    /// Twin image for the Cortex-M55.
    #[arg(long, value_name = "ELF")]
    m55_image: PathBuf,
    /// Model that the images embed.
    #[arg(long, value_name = "FILE")]
    blob: PathBuf,
    /// Print what the images log.
    #[arg(long)]
    log: bool,
    /// Print one machine-readable object as the last line.
    #[arg(long)]
    json: bool,
    /// Longest time a machine may take, seconds.
    #[arg(long, default_value_t = 900)]
    limit: u64,
}

/// Arena of the desktop run; the images report what they took of theirs.
const ARENA_BYTES: usize = 4 << 20;

fn main() -> ExitCode {
    console::conclude(run(&Options::parse()))
}

fn run(options: &Options) -> Result<()> {
    let limit = Duration::from_secs(options.limit);
    let jobs = [(M4, &options.image), (M7, &options.image), (M33, &options.m33_image), (M55, &options.m55_image)];
    // Emulation is single-threaded: the machines run side by side.
    let (desktop, machines) = thread::scope(|scope| {
        let running: Vec<_> = jobs
            .iter()
            .map(|&(machine, image)| scope.spawn(move || on_machine(machine, image, limit, options.log)))
            .collect();
        let desktop = on_desktop(&options.blob);
        let machines: Vec<Result<Report>> =
            running.into_iter().map(|job| job.join().unwrap_or_else(|_| bail!("the runner panicked"))).collect();
        (desktop, machines)
    });
    let desktop = desktop?;
    let machines: Vec<(Machine, Report)> =
        jobs.iter().zip(machines).map(|(&(machine, _), report)| Ok((machine, report?))).collect::<Result<_>>()?;
    let mut equal = true;
    for (index, digest) in desktop.iter().enumerate() {
        let mut verdict = String::from("equal");
        for (machine, report) in &machines {
            if let Some(what) = report.digests.get(index).and_then(|other| report::difference(digest, other)) {
                verdict = format!("{} DIFFERS in its {what}", machine.title);
                equal = false;
            }
        }
        say(&row(index, digest, &verdict));
    }
    summary(options, &desktop, &machines, equal)?;
    ensure!(equal, "the machines differ from the desktop");
    Ok(())
}

/// Runs every request here.
fn on_desktop(blob: &Path) -> Result<Vec<Digest>> {
    let file = BlobFile::open(blob)?;
    let mut arena = vec![0; ARENA_BYTES];
    let mut generator = Generator::new(file.model()?, &mut arena)?;
    if generator.self_test()? == Some(false) {
        bail!("{}: the self-test failed on this machine", blob.display());
    }
    let samples = SampleClips::built_in()?;
    let recorded: Vec<&[u16]> = samples.clips.iter().map(|clip| clip.tokens.as_slice()).collect();
    let start = Instant::now();
    let mut digests = (0..twin::REQUESTS)
        .map(|index| twin::run(&mut generator, index, &recorded).with_context(|| format!("request {index}")))
        .collect::<Result<Vec<_>>>()?;
    drop(generator);
    for index in 0..twin::SMALL_REQUESTS {
        let digest = twin::run_small(&mut arena, index);
        digests.push(digest.with_context(|| format!("request {}", twin::REQUESTS + index))?);
    }
    remark(&format!("desktop: {} requests in {:.1} s", twin::ALL, start.elapsed().as_secs_f64()));
    Ok(digests)
}

/// Runs an image and reads its report.
fn on_machine(machine: Machine, image: &Path, limit: Duration, show: bool) -> Result<Report> {
    let elf = fs::read(image).with_context(|| format!("cannot read {}", image.display()))?;
    let run = qemu::run(machine, image, limit)?;
    let lines = log::decode(&elf, &run.output).with_context(|| machine.title)?;
    if show {
        lines.iter().for_each(|line| say(&format!("{}: {line}", machine.name)));
    }
    if run.status != 0 {
        let last = lines.last().map_or("nothing was logged", String::as_str);
        bail!("{}: the image exited with {}: {last}", machine.title, run.status);
    }
    remark(&format!("{}: {} requests in {:.1} s", machine.title, twin::ALL, run.elapsed.as_secs_f64()));
    Report::read(&lines).with_context(|| machine.title)
}

fn row(index: usize, digest: &Digest, verdict: &str) -> String {
    let centimetres = |bits: u32| 100.0 * f32::from_bits(bits);
    let Digest { numbers, anchors, evaluations, before, after, joints, .. } = digest;
    format!(
        "request {index:>2}: {numbers:>2} tokens, {anchors:>2} anchors, {evaluations:>2} evaluations, {:>6.2} -> {:>6.2} cm, {joints:016x}, {verdict}",
        centimetres(*before),
        centimetres(*after),
    )
}

fn summary(options: &Options, desktop: &[Digest], machines: &[(Machine, Report)], equal: bool) -> Result<()> {
    let image = fs::read(&options.image)?;
    let check = fs::read(&options.check)?;
    let text_bytes = image::text_bytes(&image)?;
    let runtime_text_bytes = image::text_bytes(&check)?;
    let sites = image::panic_sites(&check)?;
    let (mut fused, mut chained) = image::multiply_adds(&image)?;
    for other in [&options.m33_image, &options.m55_image] {
        let (more_fused, more_chained) = image::multiply_adds(&fs::read(other)?)?;
        (fused, chained) = (fused + more_fused, chained + more_chained);
    }
    let largest = |value: fn(&Report) -> usize| machines.iter().map(|(_, report)| value(report)).max().unwrap_or(0);
    let stack_bytes = largest(|report| report.stack_bytes);
    let high_water = largest(|report| report.arena_high_water_bytes);
    let generator_bytes = largest(|report| report.generator_bytes);
    let used = desktop.iter().map(|digest| digest.arena_used).max().unwrap_or(0);

    let static_bytes = image::static_ram_bytes(&check)?;
    let ram_bytes = high_water as u64 + generator_bytes as u64 + static_bytes;
    say(&format!("stack {stack_bytes} bytes (painted)"));
    say(&format!("arena {high_water} bytes (painted), {used} taken by the largest request"));
    say(&format!(
        "RAM {ram_bytes} bytes: arena, generator {generator_bytes}, static data of the runtime {static_bytes}"
    ));
    say(&format!(
        "code {text_bytes} bytes in the twin image, {runtime_text_bytes} of the runtime alone (.text + .rodata, no model)"
    ));
    say(&format!("multiply-adds: {fused} fused, {chained} chained (those round twice, as written)"));
    say(&format!("panic sites: {}", sites.len()));
    for site in &sites {
        say(&format!("  {} calls {}", site.caller, site.callee));
    }
    let hash = |digests: &[Digest]| format!("{:016x}", twin::combine(digests));
    say(&format!("desktop {}", hash(desktop)));
    for (machine, report) in machines {
        say(&format!("{:<7} {}", machine.name, hash(&report.digests)));
    }
    say(if equal { "every bit is equal" } else { "the machines DIFFER" });
    if options.json {
        let mut object = json!({
            "requests": desktop.len(),
            "desktop": hash(desktop),
            "equal": equal,
            "stack_bytes": stack_bytes,
            "text_bytes": text_bytes,
            "runtime_text_bytes": runtime_text_bytes,
            "panic_sites": sites.len(),
            "generator_bytes": generator_bytes,
            "arena_high_water_bytes": high_water,
            "ram_bytes": ram_bytes,
            "fused_multiply_adds": fused,
        });
        for (machine, report) in machines {
            object[machine.name] = hash(&report.digests).into();
        }
        say(&object.to_string());
    }
    if high_water != used {
        bail!("the painted arena shows {high_water} bytes, the largest request says it took {used}");
    }
    if fused > 0 {
        bail!("the images hold {fused} fused multiply-adds: they round once and give other bits than the desktop");
    }
    Ok(())
}
