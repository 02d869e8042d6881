//! Multiply-accumulates of the standard request on a blob, as planned and as counted. The last line is JSON: `plan_macs` for the
//! evaluations and gradients that were made, `counted_macs`, and `plan_macs_most` for as many as the request allows.

use std::path::PathBuf;

use anyhow::{Context, Result};
use motionette_host::blob::BlobFile;
use motionette_tests::standard;

fn main() -> Result<()> {
    let path: PathBuf = std::env::args_os().nth(1).context("usage: counted BLOB")?.into();
    let blob = BlobFile::open(&path)?;
    let counted = standard::count(&blob.model()?)?;
    let (planned, most) = (counted.planned(), counted.plan.macs);
    println!(
        "{} evaluations, {} gradients: {:.1} million multiply-accumulates planned, {:.1} million counted, ratio {:.4}; \
         at most {:.1} million",
        counted.evaluations,
        counted.gradients,
        planned as f64 / 1e6,
        counted.macs as f64 / 1e6,
        planned as f64 / counted.macs as f64,
        most as f64 / 1e6
    );
    let json = serde_json::json!({ "plan_macs": planned, "counted_macs": counted.macs, "plan_macs_most": most });
    println!("{json}");
    Ok(())
}
