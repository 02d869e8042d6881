//! What a device says, in words and as JSON.

use motionette_link::message::{
    Blob, Clearance, Event, Hello, JobStage, LossAction, Measure, Owner, RefusedBlob, Start, Status, Strain, Tracking,
    Understood,
};
use serde_json::{Value, json};

use crate::cli::say;
use crate::console::strained;
use crate::device::advice_for_start;

/// A stage by name.
pub fn stage(stage: JobStage) -> &'static str {
    match stage {
        JobStage::Waiting => "waiting",
        JobStage::Reading => "reading",
        JobStage::Planning => "planning",
        JobStage::Refining => "refining",
        JobStage::Decoding => "decoding",
        JobStage::Testing => "testing",
    }
}

fn loss(action: LossAction) -> &'static str {
    match action {
        LossAction::Finish => "finish",
        LossAction::Hold => "hold",
        LossAction::Abort => "abort",
    }
}

/// A blob in a slot.
pub fn blob(blob: &Blob) -> Value {
    json!({"slot": blob.slot, "sequence": blob.sequence, "length": blob.length, "crc32": format!("{:08x}", blob.crc32)})
}

fn refused(refused: &RefusedBlob) -> Value {
    json!({"blob": blob(&refused.blob), "why": refused.why.to_string()})
}

fn say_refused(refused: &RefusedBlob) {
    say(&format!("the blob in slot {} is not used: {}", refused.blob.slot, refused.why));
}

/// What a device understood of a prompt.
pub fn understood(understood: &Understood) -> Value {
    json!({"phrase": understood.phrase.as_str(), "score": understood.score})
}

/// What the anchors ask of a motion.
pub fn strain(strain: Strain) -> Value {
    json!({"measure": strain.measure.0, "value": strain.value, "anchor": strain.anchor})
}

/// How far a motion is from its tracks.
pub fn tracking(it: Tracking) -> Value {
    json!({"mean_m": it.mean, "worst_m": it.worst, "track": it.track, "frame": it.frame, "hurried": it.hurried})
}

/// How far a motion keeps clear of its obstacles.
pub fn clearance(it: Clearance) -> Value {
    let Clearance { least, missing, obstacle, joint, frame } = it;
    json!({
        "least_m": least, "missing_m": missing, "kept": it.kept(), "obstacle": obstacle, "joint": joint, "frame": frame,
    })
}

/// What came of tracks and obstacles, in words.
pub fn followed(tracking: Option<Tracking>, clearance: Option<Clearance>) -> impl Iterator<Item = String> {
    let tracking = tracking.map(|Tracking { mean, worst, track, frame, hurried }| {
        let (mean, worst) = (100.0 * mean, 100.0 * worst);
        let hurried = if hurried > 0 { format!("; {hurried} positions too fast to follow") } else { String::new() };
        format!("tracks: {mean:.2} cm off, {worst:.2} cm at worst (track {track}, frame {frame}){hurried}")
    });
    let clearance = clearance.map(|it| {
        let (least, missing) = (100.0 * it.least, 100.0 * it.missing);
        let short = if it.kept() { String::new() } else { format!(", {missing:.1} cm of the margin are missing") };
        let place = format!("joint {} and obstacle {}, frame {}", it.joint, it.obstacle, it.frame);
        format!("obstacles: {least:.1} cm away at least ({place}){short}")
    });
    tracking.into_iter().chain(clearance)
}

/// A motion that was made, in words.
pub fn made(understood: Option<&Understood>, strain: Option<Strain>) -> impl Iterator<Item = String> {
    let understood = understood.map(|it| format!("understood: {} ({:.2})", it.phrase, it.score));
    let strain = strain.map(|Strain { measure, value, anchor }| match measure {
        Measure::DISTANCE => format!("anchor {anchor} is missed most, by {:.2} cm", 100.0 * value),
        Measure::STRAIN => format!("strain {}", strained(value, &format!("anchor {anchor}"))),
        _ => format!("anchor {anchor} strains the motion most, by {value:.3}"),
    });
    understood.into_iter().chain(strain)
}

/// How a start stands.
fn start(start: Start) -> Value {
    let (state, channel, why) = match start {
        Start::Reading => ("reading", None, None),
        Start::Waiting => ("waiting", None, None),
        Start::Creeping => ("creeping", None, None),
        Start::Ready => ("ready", None, None),
        Start::Refused { channel, why } => ("refused", Some(channel), Some(why.to_string())),
    };
    json!({"state": state, "channel": channel, "why": why, "hint": advice_for_start(start)})
}

/// How a start stands, in words, if it has not come to its end, and what to do.
pub fn say_start(start: Start) {
    if start != Start::Ready {
        say(&start.to_string());
    }
    if let Some(advice) = advice_for_start(start) {
        say(&format!("  hint: {advice}"));
    }
}

pub fn hello(hello: &Hello) -> Value {
    let limits = &hello.limits;
    json!({
        "protocol": motionette_link::message::PROTOCOL,
        "version": hello.version.as_str(),
        "preset": hello.preset.as_str(),
        "model": hello.model.as_ref().map(|model| json!({
            "name": model.name.as_str(), "frame_rate": model.frame_rate, "frames": model.frames,
        })),
        "blob": hello.blob.as_ref().map(blob),
        "refused": hello.refused.as_ref().map(refused),
        "limits": {
            "text_bytes": limits.text_bytes,
            "anchors": limits.anchors,
            "chunk_bytes": limits.chunk_bytes,
            "blob_bytes": limits.blob_bytes,
            "condition_bytes": limits.condition_bytes,
            "spans": limits.spans,
            "silence_ms": limits.silence_ms,
            "on_silence": loss(limits.on_silence),
        },
    })
}

pub fn say_hello(hello: &Hello) {
    say(&format!("robot {}, link {}", hello.preset, hello.version));
    match &hello.model {
        Some(model) => {
            let seconds = f64::from(model.frames) / f64::from(model.frame_rate.max(1));
            say(&format!("model {}: up to {seconds} s at {} frames a second", model.name, model.frame_rate));
        }
        None => say("no model"),
    }
    if let Some(blob) = &hello.blob {
        say(&format!("blob in slot {}: {} bytes, CRC-32 {:08x}", blob.slot, blob.length, blob.crc32));
    }
    if let Some(refused) = &hello.refused {
        say_refused(refused);
    }
    let limits = &hello.limits;
    let (text, anchors, bytes) = (limits.text_bytes, limits.anchors, limits.blob_bytes);
    let conditions = match limits.condition_bytes {
        0 => "no tracks and obstacles".to_owned(),
        bytes => match limits.spans {
            0 => format!("tracks and obstacles of {bytes} bytes"),
            spans => format!("tracks, obstacles and a timeline of {spans} spans in {bytes} bytes"),
        },
    };
    say(&format!("takes texts of {text} bytes, {anchors} anchors, {conditions}, blobs of {bytes} bytes"));
    say(&match limits.silence_ms {
        0 => "goes on without a host".to_owned(),
        ms => format!("after {ms} ms without a host: {}", loss(limits.on_silence)),
    });
}

/// An event as an object with its `event` by name.
pub fn event(event: &Event) -> Value {
    match event {
        Event::Ready {
            job,
            frames,
            control_error,
            understood: heard,
            strain: strained,
            tracking: off,
            clearance: clear,
        } => json!({
            "event": "ready", "job": job, "frames": frames, "control_error_m": control_error,
            "understood": heard.as_ref().map(understood), "strain": strained.map(strain),
            "tracking": off.map(tracking), "clearance": clear.map(clearance),
        }),
        Event::Finished => json!({"event": "finished"}),
        Event::Failed { job, why } => json!({"event": "failed", "job": job, "why": why.to_string()}),
        Event::SelfTest { job, passed } => json!({"event": "self-test", "job": job, "passed": passed}),
        Event::HostLost(action) => json!({"event": "host-lost", "action": loss(*action)}),
        Event::Start(to) => json!({"event": "start", "start": start(*to)}),
    }
}

/// An event in words.
pub fn words(event: &Event) -> String {
    match event {
        Event::Ready { frames, control_error, understood, strain, tracking, clearance, .. } => {
            let off = control_error.map(|error| format!("{:.2} cm off its anchors", 100.0 * error));
            let more = off.into_iter().chain(made(understood.as_ref(), *strain)).chain(followed(*tracking, *clearance));
            more.fold(format!("a motion of {frames} frames is ready"), |line, next| line + ", " + &next)
        }
        Event::Finished => "the motion was played".to_owned(),
        Event::Failed { why, .. } => format!("failed: {why}"),
        Event::SelfTest { passed, .. } => match passed {
            Some(true) => "self-test passed".to_owned(),
            Some(false) => "self-test failed".to_owned(),
            None => "the blob carries no self-test".to_owned(),
        },
        Event::HostLost(action) => format!("the device lost its host: {}", loss(*action)),
        Event::Start(to) => to.to_string(),
    }
}

pub fn status(status: &Status) -> Value {
    let device = &status.device;
    json!({
        "session": match status.owner {
            Owner::You => "own",
            Owner::Another => "another host's",
            Owner::Nobody => "none",
        },
        "start": start(device.start),
        "state": device.state.name(),
        "work": device.work.map(|work| json!({
            "job": work.job, "stage": stage(work.stage), "step": work.step, "steps": work.steps,
        })),
        "frames_queued": device.frames_queued,
        "ticks": device.ticks,
        "missed_ticks": device.missed_ticks,
        "starved_ticks": device.starved_ticks,
        "limited_ticks": device.limited_ticks,
        "bus_faults": device.bus_faults,
        "outcome": status.outcome.as_ref().map(event),
        "refused": status.refused.as_ref().map(refused),
        "transfer": status.transfer.map(|t| json!({"next": t.next, "length": t.length})),
        "staged": status.staged.map(|t| json!({"next": t.next, "length": t.length})),
        "host_lost": status.host_lost.map(loss),
        "skipped": {
            "encoding": status.skipped.encoding,
            "too_long": status.skipped.too_long,
            "checksum": status.skipped.checksum,
            "unfit": status.skipped.unfit,
        },
        "unsent": status.unsent,
    })
}

pub fn say_status(status: &Status) {
    let device = &status.device;
    if status.owner == Owner::Another {
        say("another host has the robot");
    }
    say_start(device.start);
    say(&format!("{}, {} frames queued", device.state.name(), device.frames_queued));
    if let Some(work) = device.work {
        say(&format!("request {}: {}, {} of {}", work.job, stage(work.stage), work.step, work.steps));
    }
    if let Some(refused) = &status.refused {
        say_refused(refused);
    }
    if let Some(transfer) = status.transfer {
        say(&format!("a blob is being transferred: {} of {} bytes", transfer.next, transfer.length));
    }
    if let Some(staged) = status.staged.filter(|staged| staged.next < staged.length) {
        say(&format!("conditions are on their way: {} of {} bytes", staged.next, staged.length));
    }
    if let Some(outcome) = &status.outcome {
        say(&format!("last: {}", words(outcome)));
    }
    if let Some(action) = status.host_lost {
        say(&format!("the device had lost its host: {}", loss(action)));
    }
    let (ticks, missed, starved) = (device.ticks, device.missed_ticks, device.starved_ticks);
    let (limited, bus) = (device.limited_ticks, device.bus_faults);
    say(&format!(
        "{ticks} ticks: {missed} missed, {starved} starved, {limited} limited, {bus} not heard by the servos"
    ));
    let (skipped, unsent) = (status.skipped.total(), status.unsent);
    say(&format!("link: {skipped} broken frames skipped, {unsent} replies unsent"));
}
