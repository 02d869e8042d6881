//! Counts the instructions of layers and of the standard request on emulated cores, exactly, and compares them with the
//! budgets and with CMSIS-NN. Started by `cargo xtask bench`, which builds images and plugin first.

use std::{
    collections::HashMap,
    fmt::Write as _,
    fs,
    path::{Path, PathBuf},
    process::{Command, ExitCode},
    time::Duration,
};

use anyhow::{Context, Result, bail};
use clap::Parser;
use motionette::MOST_ROWS;
use motionette_host::console::{self, remark, say};
use motionette_twin::{
    image,
    qemu::{self, MACHINES, Machine},
};
use serde_json::{Value, json};

/// Counts instructions on emulated Cortex-M cores.
#[derive(Parser)]
struct Options {
    /// Bench image of a core.
    #[arg(long, value_name = "CORE=ELF", value_parser = named)]
    bench: Vec<(String, PathBuf)>,
    /// Image of the standard request for a core.
    #[arg(long, value_name = "CORE=ELF", value_parser = named)]
    request: Vec<(String, PathBuf)>,
    /// Check image for the Cortex-M4F: code size.
    #[arg(long, value_name = "ELF")]
    check: PathBuf,
    /// The counting plugin.
    #[arg(long, value_name = "FILE")]
    plugin: PathBuf,
    /// Model that the images embed.
    #[arg(long, value_name = "FILE")]
    blob: PathBuf,
    /// Multiply-accumulates of the standard request: one JSON object with `plan_macs` and `counted_macs`.
    #[arg(long, value_name = "JSON")]
    macs: String,
    /// Result of the desktop's bench, to be joined to the JSON.
    #[arg(long, value_name = "FILE")]
    desktop: Option<PathBuf>,
    /// Lists the functions in which the standard request's instructions are spent on the first core.
    #[arg(long)]
    profile: bool,
    /// Write page and JSON into this folder.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one machine-readable object as the last line.
    #[arg(long)]
    json: bool,
}

fn named(text: &str) -> Result<(String, PathBuf), String> {
    let (name, path) = text.split_once('=').ok_or("CORE=ELF is wanted")?;
    Ok((name.to_owned(), path.into()))
}

/// A region of the bench image.
struct Region {
    number: usize,
    name: &'static str,
    /// Multiply-accumulates, or elements.
    work: u64,
    /// Most instructions for each on M4; DESIGN's budget.
    budget: Option<f64>,
    /// CMSIS-NN on M4, M7 and M33, and on M55: its best kernel of the kind, int8 activations on the former, int16 on M55.
    peers: [Option<f64>; 2],
}

const LINEAR: u64 = 49 * 192 * 192;
const ROW: u64 = 192 * 768;
/// Taps inside the sequence, at dilation 3.
const CONVOLUTION: u64 = (3 * 49 - 2 * 3) * 128 * 128;

const fn region(number: usize, name: &'static str, work: u64, budget: Option<f64>, peers: [Option<f64>; 2]) -> Region {
    Region { number, name, work, budget, peers }
}

const REGIONS: [Region; 11] = [
    region(1, "linear_49x192x192", LINEAR, Some(0.97), [Some(1.71), Some(0.40)]),
    region(2, "linear_49x192x192_kernel", LINEAR, Some(0.86), [None, None]),
    region(3, "linear_1x192x768", ROW, Some(1.30), [Some(2.13), Some(1.04)]),
    region(4, "linear_1x192x768_kernel", ROW, None, [None, None]),
    region(9, "linear4_49x192x192", LINEAR, None, [Some(5.13), Some(0.51)]),
    region(10, "linear4_49x192x192_kernel", LINEAR, None, [None, None]),
    region(5, "conv3_49x128x128", CONVOLUTION, Some(0.95), [Some(1.80), Some(0.40)]),
    region(6, "conv3_49x128x128_kernel", 3 * 49 * 128 * 128, None, [None, None]),
    region(7, "linear_transposed_49x192x192", LINEAR, Some(0.97), [None, None]),
    region(8, "linear_transposed_49x192x192_kernel", LINEAR, Some(0.86), [None, None]),
    region(11, "softmax_49x49", 49 * 49, None, [Some(54.0), Some(49.0)]),
];

/// Regions of the request image.
const STAGES: [(usize, &str); 4] = [(3, "reading"), (4, "planning"), (5, "refining"), (6, "decoding")];
const OPENING: usize = 1;
const REQUEST: usize = 2;
/// The same, as many rows at a time as may be.
const ROOMY: usize = 7;
/// The motion of its tokens as decoded, and edited onto 32 anchors.
const DECODED: usize = 8;
const EDITED: usize = 9;
const LIMIT: Duration = Duration::from_secs(900);

fn main() -> ExitCode {
    console::conclude(run(&Options::parse()))
}

/// Everything that was counted on one machine.
struct Counted {
    machine: Machine,
    /// Instructions of the bench image by region.
    kernels: HashMap<usize, u64>,
    /// Of the request image.
    request: HashMap<usize, u64>,
    /// What the request image printed.
    printed: HashMap<String, u64>,
}

fn run(options: &Options) -> Result<()> {
    let mut all = Vec::new();
    for machine in MACHINES {
        // The M7 runs the M4F's images.
        let of = |list: &[(String, PathBuf)]| {
            let name = if machine.name == "m7" { "m4" } else { machine.name };
            list.iter().find(|(core, _)| core == name).map(|(_, path)| path.clone())
        };
        let (Some(bench), Some(request)) = (of(&options.bench), of(&options.request)) else { continue };
        remark(machine.title);
        let (_, kernels) = counted(machine, &bench, &options.plugin, false)?;
        let places = options.profile && all.is_empty();
        let (output, report) = counted(machine, &request, &options.plugin, places)?;
        if places {
            profile(&fs::read(&request)?, &report)?;
        }
        let printed = pairs(&output);
        all.push(Counted { machine, kernels: regions(&kernels), request: regions(&report), printed });
    }
    let [first, others @ ..] = all.as_slice() else { bail!("no images: give --bench and --request") };
    for other in others {
        if other.printed.get("hash") != first.printed.get("hash") {
            bail!("{} and {} made different motions", first.machine.title, other.machine.title);
        }
    }
    let object = object(options, &all)?;
    let page = page(&all, &object)?;
    say(&page);
    if let Some(out) = &options.out {
        fs::create_dir_all(out).with_context(|| format!("cannot make {}", out.display()))?;
        fs::write(out.join("cortex-m.md"), &page).with_context(|| format!("cannot write into {}", out.display()))?;
        let text = serde_json::to_string_pretty(&object)? + "\n";
        fs::write(out.join("cortex-m.json"), text).with_context(|| format!("cannot write into {}", out.display()))?;
    }
    if options.json {
        say(&object.to_string());
    }
    Ok(())
}

/// Runs an image with the plugin: what it printed, and the plugin's report.
fn counted(machine: Machine, image: &Path, plugin: &Path, places: bool) -> Result<(String, String)> {
    let (run, report) = qemu::count(machine, image, LIMIT, plugin, places)?;
    let output = String::from_utf8_lossy(&run.output).into_owned();
    if run.status != 0 {
        bail!("{}: {} exited with {}: {}", machine.title, image.display(), run.status, output.trim());
    }
    Ok((output, report))
}

/// Instructions by region: `region N entries E instructions I`.
fn regions(report: &str) -> HashMap<usize, u64> {
    let read = |line: &str| {
        let words: Vec<&str> = line.split(' ').collect();
        let ["region", number, "entries", _, "instructions", count] = words[..] else { return None };
        Some((number.parse().ok()?, count.parse().ok()?))
    };
    report.lines().filter_map(read).collect()
}

/// The numbers of lines `bench key=value ...`.
fn pairs(output: &str) -> HashMap<String, u64> {
    let lines = output.lines().filter_map(|line| line.strip_prefix("bench "));
    let pairs = lines.flat_map(|line| line.split(' ')).filter_map(|pair| pair.split_once('='));
    pairs.filter_map(|(key, value)| Some((key.to_owned(), value.parse().ok()?))).collect()
}

/// Prints where instructions were spent, by function.
fn profile(elf: &[u8], report: &str) -> Result<()> {
    let functions = image::functions(elf)?;
    let mut spent: HashMap<&str, u64> = HashMap::new();
    for line in report.lines().filter_map(|line| line.strip_prefix("at ")) {
        let (address, count) = line.split_once(' ').context("a line of the plugin's report")?;
        let address = u64::from_str_radix(address, 16)?;
        let after = functions.partition_point(|(start, _)| *start <= address);
        let name = after.checked_sub(1).map_or("?", |at| functions[at].1.as_str());
        *spent.entry(name).or_default() += count.parse::<u64>()?;
    }
    let mut spent: Vec<(&str, u64)> = spent.into_iter().collect();
    spent.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    let all: u64 = spent.iter().map(|(_, count)| count).sum();
    for (name, count) in spent.iter().take(40) {
        say(&format!("{:9.1} M {:5.1} %  {name}", *count as f64 / 1e6, 100.0 * *count as f64 / all as f64));
    }
    Ok(())
}

fn object(options: &Options, all: &[Counted]) -> Result<Value> {
    let macs: Value = serde_json::from_str(&options.macs).context("--macs is no JSON object")?;
    let mut kernels = Vec::new();
    for counted in all {
        for region in &REGIONS {
            let count = counted.kernels.get(&region.number).with_context(|| format!("region {}", region.name))?;
            let key =
                if region.name.starts_with("softmax") { "instructions_per_element" } else { "instructions_per_mac" };
            let per = (*count as f64 / region.work as f64 * 1e4).round() / 1e4;
            kernels.push(json!({"core": counted.machine.name, "kernel": region.name, key: per}));
        }
    }
    let first = &all[0];
    let printed = |key: &str| first.printed.get(key).copied().with_context(|| format!("the image printed no `{key}`"));
    let of = |counted: &Counted, region: usize| counted.request.get(&region).copied().unwrap_or(0);
    let stages: serde_json::Map<String, Value> =
        STAGES.iter().map(|(number, name)| ((*name).to_owned(), of(first, *number).into())).collect();
    let check = fs::read(&options.check)?;
    let mut object = json!({
        "kernels": kernels,
        "opening_instructions_m4": of(first, OPENING),
        "stages": stages,
        "evaluations": printed("evaluations")?,
        "gradients": printed("gradients")?,
        "stack_bytes": printed("stack")?,
        "text_bytes": image::text_bytes(&check)?,
        "arena_bytes": printed("arena")?,
        "roomy_arena_bytes": printed("roomy_arena")?,
        "edit_rounds": printed("edit_rounds")?,
        "ram_bytes": printed("arena")? + printed("generator")? + image::static_ram_bytes(&check)?,
        "blob_bytes": fs::metadata(&options.blob)?.len(),
        "plan_macs": macs["plan_macs"],
        "counted_macs": macs["counted_macs"],
        "commit": commit(),
    });
    for counted in all {
        object[format!("request_instructions_{}", counted.machine.name)] = of(counted, REQUEST).into();
        object[format!("roomy_request_instructions_{}", counted.machine.name)] = of(counted, ROOMY).into();
        object[format!("edit_instructions_{}", counted.machine.name)] =
            of(counted, EDITED).saturating_sub(of(counted, DECODED)).into();
    }
    if let Some(path) = options.desktop.as_deref().filter(|path| path.exists()) {
        let desktop: Value = serde_json::from_slice(&fs::read(path)?).with_context(|| path.display().to_string())?;
        object["desktop"] = desktop["desktop"].clone();
    }
    Ok(object)
}

/// The commit that was measured, with `+` where files differ from it.
fn commit() -> String {
    let git = |arguments: &[&str]| {
        let output = Command::new("git").args(arguments).output().ok()?;
        output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    let Some(commit) = git(&["rev-parse", "--short=10", "HEAD"]) else { return "unknown".to_owned() };
    let dirty = git(&["status", "--porcelain", "--untracked-files=no"]).is_some_and(|files| !files.is_empty());
    commit + if dirty { "+" } else { "" }
}

fn page(all: &[Counted], object: &Value) -> Result<String> {
    let mut page = String::from(
        "# Instructions on Cortex-M\n\nExact counts from emulated cores (QEMU with the plugin `firmware-sim/twin/count.c`), the \
         same in every run: `cargo xtask bench --out docs/results`. QEMU shows no wait states, caches or dual issue, so these \
         are instructions, not cycles. Images: release, optimisation level 2, link-time optimisation.\n\n",
    );
    for counted in all {
        writeln!(page, "- {}: {}", counted.machine.name, counted.machine.title)?;
    }
    writeln!(page, "\nCommit {}.\n", object["commit"].as_str().unwrap_or("unknown"))?;
    page += "## Kernels\n\nInstructions a multiply-accumulate, int16 activations by int8 weights, the whole op from f32 rows to \
             f32 rows; `_kernel` is the integer part alone, rows already int16; `linear4`: 4-bit weights. Softmax: instructions an element. CMSIS-NN: its \
             best kernel of the kind, int8 by int8 on M4, M7 and M33, int16 by int8 on M55 (for a convolution, its 1x1; its int8 \
             kernels take 0.22 to 0.54 there), for 4-bit weights its fully_connected_s4; softmax_s16. Only taps inside the \
             sequence count as work of the convolution.\n\n";
    page += "| kernel |";
    for counted in all {
        write!(page, " {} |", counted.machine.name)?;
    }
    page += " budget (m4) | CMSIS-NN m4, m7, m33 | m55 |\n|---|";
    page += &"---|".repeat(all.len() + 3);
    page += "\n";
    let or_dash = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value}"));
    for region in &REGIONS {
        write!(page, "| {} |", region.name)?;
        for counted in all {
            let count = counted.kernels.get(&region.number).copied().unwrap_or(0);
            write!(page, " {:.3} |", count as f64 / region.work as f64)?;
        }
        let [dsp, mve] = region.peers;
        writeln!(page, " {} | {} | {} |", or_dash(region.budget), or_dash(dsp), or_dash(mve))?;
    }
    page += "\n## The standard request\n\n49 tokens from text, five steps guided in one pass, two root anchors and two wrists, default \
             refinement; millions of instructions. The stages are of the second of two equal requests; reading the prompt and the \
             anchors come in `reading`, the edit onto the anchors in `decoding`.\n\n| |";
    for counted in all {
        write!(page, " {} |", counted.machine.name)?;
    }
    page += "\n|---|";
    page += &"---:|".repeat(all.len());
    page += "\n";
    let roomy = format!("the same, {MOST_ROWS} rows at a time");
    let lines = [(OPENING, "opening the model, once"), (REQUEST, "the request"), (ROOMY, roomy.as_str())];
    for (number, name) in lines.into_iter().chain(STAGES) {
        write!(page, "| {name} |")?;
        for counted in all {
            write!(page, " {:.1} |", counted.request.get(&number).copied().unwrap_or(0) as f64 / 1e6)?;
        }
        page += "\n";
    }
    write!(page, "| the edit alone, 196 frames, 32 anchors, {} rounds |", object["edit_rounds"])?;
    for counted in all {
        let key = format!("edit_instructions_{}", counted.machine.name);
        write!(page, " {:.1} |", object[key.as_str()].as_u64().unwrap_or(0) as f64 / 1e6)?;
    }
    page += "\n";
    let number = |key: &str| object[key].as_u64().unwrap_or(0);
    writeln!(
        page,
        "\n{} decoder evaluations, {} gradients; {:.1} M multiply-accumulates counted, {:.1} M planned for what was done.\n",
        number("evaluations"),
        number("gradients"),
        number("counted_macs") as f64 / 1e6,
        number("plan_macs") as f64 / 1e6
    )?;
    page += "## Memory\n\n| | bytes | limit |\n|---|---:|---:|\n";
    for (name, key, limit) in [
        ("code and constants of the runtime (M4F)", "text_bytes", "198656"),
        ("model", "blob_bytes", ""),
        ("arena of the request", "arena_bytes", ""),
        (&format!("the same, {MOST_ROWS} rows at a time"), "roomy_arena_bytes", ""),
        ("arena, generator and static data", "ram_bytes", "327680"),
        ("stack, painted", "stack_bytes", "16384"),
    ] {
        writeln!(page, "| {name} | {} | {limit} |", number(key))?;
    }
    Ok(page)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_are_read() {
        let report = "region 3 entries 2 instructions 1500\nat 00000010 7\nregion 11 entries 1 instructions 8\n";
        assert_eq!(regions(report), HashMap::from([(3, 1500), (11, 8)]));
        let printed = pairs("hello\nbench check=5\nbench hash=18446744073709551615 stack=9\n");
        assert_eq!(printed["hash"], u64::MAX);
        assert_eq!((printed["check"], printed["stack"]), (5, 9));
    }
}
