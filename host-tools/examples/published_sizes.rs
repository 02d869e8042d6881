//! Models of the sizes that MoMask and T2M-GPT were published with, random weights: written as their checkpoints, converted, run, and compared with the
//! reference on the tokens that the runtime chose. What is printed: sizes, exact memory, seconds, the share of tokens that are the reference's.
//!
//! `cargo run --release -p motionette-host --example published_sizes -- FOLDER [momask|t2mgpt]`

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result, bail, ensure};
use motionette::codec::codebook::Codebooks;
use motionette::numerics::hash::Stream;
use motionette::request::prompt::Prompt;
use motionette::{Generator, Length, Planning, Request, Sampling};
use motionette_host::blob::BlobFile;
use motionette_host::checkpoint::{self, PublishedPlanner, published};
use motionette_host::convert::{self, CardText, Options, PublishedSource};
use motionette_host::reference::published::draw::Choice;
use motionette_host::reference::published::{Gpt, Mask, Residual, masked};
use safetensors::tensor::{Dtype, TensorView};

/// Named tensors of random numbers.
struct Weights {
    stream: Stream,
    tensors: BTreeMap<String, (Vec<usize>, Vec<u8>)>,
}

impl Weights {
    fn new(seed: u64) -> Self {
        Self { stream: Stream::new(seed), tensors: BTreeMap::new() }
    }

    /// Uniform numbers, `gain` times those that keep a sum of `terms` of them in size.
    fn put(&mut self, name: &str, shape: &[usize], terms: usize, gain: f32) {
        let most = gain * (3.0 / terms as f32).sqrt();
        let count = shape.iter().product();
        let bytes = (0..count).flat_map(|_| (most * (2.0 * self.stream.unit() - 1.0)).to_le_bytes()).collect();
        self.tensors.insert(name.to_owned(), (shape.to_vec(), bytes));
    }

    fn linear(&mut self, name: &str, outputs: usize, inputs: usize) {
        self.put(&format!("{name}.weight"), &[outputs, inputs], inputs, 1.0);
        self.put(&format!("{name}.bias"), &[outputs], inputs, 1.0);
    }

    fn conv(&mut self, name: &str, outputs: usize, inputs: usize, kernel: usize) {
        self.put(&format!("{name}.weight"), &[outputs, inputs, kernel], inputs * kernel, 1.0);
        self.put(&format!("{name}.bias"), &[outputs], inputs * kernel, 1.0);
    }

    fn norm(&mut self, name: &str, width: usize) {
        let ones = (0..width).flat_map(|_| 1.0_f32.to_le_bytes()).collect();
        self.tensors.insert(format!("{name}.weight"), (vec![width], ones));
        self.put(&format!("{name}.bias"), &[width], width, 1.0);
    }

    /// Encoder and decoder of both repositories.
    fn vqvae(&mut self, base: &str, width: usize, code: usize, depth: usize) {
        let blocks = |this: &mut Self, name: &str| {
            for block in 0..depth {
                this.conv(&format!("{name}.model.{block}.conv1"), width, width, 3);
                this.conv(&format!("{name}.model.{block}.conv2"), width, width, 1);
            }
        };
        self.conv(&format!("{base}encoder.model.0"), width, 263, 3);
        for stage in [2, 3] {
            self.conv(&format!("{base}encoder.model.{stage}.0"), width, width, 4);
            blocks(self, &format!("{base}encoder.model.{stage}.1"));
        }
        self.conv(&format!("{base}encoder.model.4"), code, width, 3);
        self.conv(&format!("{base}decoder.model.0"), width, code, 3);
        for stage in [2, 3] {
            blocks(self, &format!("{base}decoder.model.{stage}.0"));
            self.conv(&format!("{base}decoder.model.{stage}.2"), width, width, 3);
        }
        self.conv(&format!("{base}decoder.model.4"), width, width, 3);
        self.conv(&format!("{base}decoder.model.6"), 263, width, 3);
    }

    /// What MoMask's two transformers have in common.
    fn trunk(&mut self, (width, hidden, layers): (usize, usize, usize), code: usize, outputs: usize) {
        self.linear("cond_emb", width, 512);
        self.linear("input_process.poseEmbedding", width, code);
        self.put("position_enc.pe", &[5000, 1, width], 1, 0.5);
        for layer in 0..layers {
            let name = format!("seqTransEncoder.layers.{layer}");
            self.put(&format!("{name}.self_attn.in_proj_weight"), &[3 * width, width], width, 1.0);
            self.put(&format!("{name}.self_attn.in_proj_bias"), &[3 * width], width, 1.0);
            self.linear(&format!("{name}.self_attn.out_proj"), width, width);
            self.linear(&format!("{name}.linear1"), hidden, width);
            self.linear(&format!("{name}.linear2"), width, hidden);
            self.norm(&format!("{name}.norm1"), width);
            self.norm(&format!("{name}.norm2"), width);
        }
        self.linear("output_process.dense", width, width);
        self.norm("output_process.LayerNorm", width);
        self.linear("output_process.poseFinal", outputs, width);
    }

    fn write(&self, path: &Path) -> Result<()> {
        let views = self
            .tensors
            .iter()
            .map(|(name, (shape, bytes))| Ok((name, TensorView::new(Dtype::F32, shape.clone(), bytes)?)));
        let views: Vec<_> = views.collect::<Result<_>>()?;
        std::fs::write(path, safetensors::serialize(views, None)?).with_context(|| path.display().to_string())
    }
}

/// `key: value` lines.
fn options(pairs: &[(&str, usize)]) -> String {
    let words = [("vq_act", "relu"), ("vq_norm", "None"), ("shared_codebook", "False"), ("name", "published_sizes")];
    let lines = pairs.iter().map(|(key, value)| format!("{key}: {value}\n"));
    lines.chain(words.iter().map(|(key, value)| format!("{key}: {value}\n"))).collect()
}

fn statistics(folder: &Path) -> Result<()> {
    for (name, value) in [("mean", 0.0), ("std", 0.1)] {
        let path = folder.join(format!("{name}.npy"));
        let mut file = std::fs::File::create(&path)?;
        motionette_host::import::npy::write(&mut file, &[263], &[value; 263])?;
    }
    Ok(())
}

fn momask(folder: &Path) -> Result<()> {
    let (width, code, codes, quantizers, depth) = (512, 512, 512, 6, 3);
    let sizes = (384, 1024, 8);
    let mut rvq = Weights::new(1);
    rvq.vqvae("", width, code, depth);
    for quantizer in 0..quantizers {
        rvq.put(&format!("quantizer.layers.{quantizer}.codebook"), &[codes, code], 1, 0.5);
    }
    rvq.write(&folder.join("rvq.safetensors"))?;
    let text = options(&[
        ("width", width),
        ("depth", depth),
        ("down_t", 2),
        ("stride_t", 2),
        ("code_dim", code),
        ("nb_code", codes),
        ("dilation_growth_rate", 3),
        ("num_quantizers", quantizers),
    ]);
    std::fs::write(folder.join("opt.txt"), text)?;
    let transformer = options(&[("latent_dim", sizes.0), ("ff_size", sizes.1), ("n_layers", sizes.2), ("n_heads", 6)]);
    for name in ["mask_opt.txt", "res_opt.txt"] {
        std::fs::write(folder.join(name), &transformer)?;
    }
    let mut mask = Weights::new(2);
    mask.trunk(sizes, code, codes);
    mask.put("token_emb.weight", &[codes + 2, code], 1, 0.5);
    mask.write(&folder.join("mask.safetensors"))?;
    let mut residual = Weights::new(3);
    residual.trunk(sizes, code, code);
    residual.linear("quant_emb", sizes.0, quantizers);
    residual.put("embed_proj_shared_weight", &[quantizers - 2, codes + 1, code], code, 1.0);
    residual.put("token_embed_weight_", &[1, codes + 1, code], 1, 0.5);
    residual.put("output_proj_weight_", &[1, codes + 1, code], code, 1.0);
    residual.write(&folder.join("res.safetensors"))?;
    statistics(folder)
}

fn t2mgpt(folder: &Path) -> Result<()> {
    let (width, code, codes, depth) = (512, 512, 512, 3);
    let (d, layers, places) = (1024, 9, 51);
    let mut vq = Weights::new(4);
    vq.vqvae("vqvae.", width, code, depth);
    vq.put("vqvae.quantizer.codebook", &[codes, code], 1, 0.5);
    vq.write(&folder.join("t2mgpt_vq.safetensors"))?;
    let mut gpt = Weights::new(5);
    gpt.linear("trans_base.cond_emb", d, 512);
    gpt.put("trans_base.pos_embed.embed", &[places, 1, d], 1, 0.5);
    gpt.put("trans_base.tok_emb.weight", &[codes + 2, d], 1, 0.5);
    for layer in 0..2 * layers {
        let part = if layer < layers { "trans_base" } else { "trans_head" };
        let name = format!("{part}.blocks.{}", layer % layers);
        for part in ["query", "key", "value", "proj"] {
            gpt.linear(&format!("{name}.attn.{part}"), d, d);
        }
        gpt.linear(&format!("{name}.mlp.0"), 4 * d, d);
        gpt.linear(&format!("{name}.mlp.2"), d, 4 * d);
        gpt.norm(&format!("{name}.ln1"), d);
        gpt.norm(&format!("{name}.ln2"), d);
    }
    gpt.norm("trans_head.ln_f", d);
    gpt.put("trans_head.head.weight", &[codes + 1, d], d, 1.0);
    gpt.write(&folder.join("t2mgpt_trans.safetensors"))?;
    let json = serde_json::json!({
        "width": width, "depth": depth, "down_t": 2, "stride_t": 2, "code_dim": code, "nb_code": codes,
        "dilation_growth_rate": 3, "vq_act": "relu", "vq_norm": null, "shared_codebook": "False",
        "embed_dim_gpt": d, "num_layers": layers, "n_head_gpt": 16, "block_size": places, "ff_rate": 4, "clip_dim": 512,
    });
    std::fs::write(folder.join("t2mgpt_args.json"), json.to_string())?;
    statistics(folder)
}

/// A blob of the files, and how long it took.
fn converted(
    folder: &Path,
    tokenizer: &str,
    planner: &PublishedPlanner,
    residual: Option<&published::Residual>,
) -> Result<BlobFile> {
    let begin = Instant::now();
    let path = folder.join(tokenizer);
    let tokenizer = checkpoint::load(&path)?;
    let source = PublishedSource { planner, residual, bank: &[] };
    let options = Options { wide_layers: true, wide_planner: true, ..Options::PLAIN };
    let card = CardText { name: "published sizes".into(), ..CardText::default() };
    let blob = convert::convert_published(&tokenizer, &source, &options, &[], &card, |_| ())?.blob;
    let blob = BlobFile::new(blob, &path)?;
    println!("  blob {:.1} MB in {:.1} s", blob.bytes().len() as f64 / 1e6, begin.elapsed().as_secs_f64());
    Ok(blob)
}

/// The tokens of a request, with what it took.
fn run(blob: &BlobFile, request: &Request<'_>) -> Result<Vec<u16>> {
    let plan = Generator::new(blob.model()?, &mut [])?.plan(request)?;
    let mut memory = vec![0_u128; plan.arena_bytes.div_ceil(16)];
    let mut generator = Generator::new(blob.model()?, bytemuck::cast_slice_mut(&mut memory))?;
    let begin = Instant::now();
    let motion = generator.generate(request, &mut ())?;
    ensure!(motion.arena_used == plan.arena_bytes, "{} bytes used of {}", motion.arena_used, plan.arena_bytes);
    println!(
        "  plan {} arena bytes, {:.2} G multiply-accumulates; {} frames in {:.2} s",
        plan.arena_bytes,
        plan.macs as f64 / 1e9,
        motion.frames().len(),
        begin.elapsed().as_secs_f64()
    );
    Ok(motion.tokens().to_vec())
}

fn largest(row: &[f32]) -> usize {
    (0..row.len()).max_by(|&a, &b| row[a].total_cmp(&row[b]).then(b.cmp(&a))).unwrap_or_default()
}

/// Share of rows whose likeliest class is the token.
fn agreement(logits: &[f32], classes: usize, tokens: impl Iterator<Item = usize>) -> f64 {
    let rows = logits.chunks_exact(classes);
    let count = rows.len();
    rows.zip(tokens).filter(|(row, token)| largest(row) == *token).count() as f64 / count as f64
}

fn compare_momask(folder: &Path, vector: &[f32]) -> Result<()> {
    println!("MoMask: RVQ 512 wide, 6 x 512 codes; mask and residual transformer 384 x 8");
    let load = |name: &str| published::load(&folder.join(name), None);
    let (planner, residual) = (load("mask.safetensors")?, load("res.safetensors")?);
    let (PublishedPlanner::Mask(mask), PublishedPlanner::Residual(residual)) = (&planner, &residual) else {
        bail!("other planners than were written");
    };
    let blob = converted(folder, "rvq.safetensors", &planner, Some(residual))?;
    // Greedy, so that ids can be compared with the reference's whole run.
    let greedy = Planning {
        steps: 10,
        guidance: 4.0,
        length: Length::Tokens(49),
        sampling: Sampling::Greedy,
        ..Planning::DEFAULT
    };
    let tokens = run(&blob, &Request::prompt(Prompt::Vector(vector)).planned(greedy))?;
    let (mask, residual) = (Mask::<f32>::new(mask), Residual::<f32>::new(residual));
    let begin = Instant::now();
    // Equal noise for every class: greedy.
    let settings = masked::Settings { steps: 10, choice: Choice { temperature: 1.0, filter: 0.0 } };
    let steps = masked::plan((49, mask.codes), &settings, |ids| mask.guided(ids, vector, 4.0), |_, _, _| 0.5);
    let base = &steps.last().context("no steps")?.after;
    let same = base.iter().zip(tokens.iter().step_by(6)).filter(|(a, b)| **a == usize::from(**b)).count();
    println!("  reference in {:.0} s; of its own run's tokens {same} of 49", begin.elapsed().as_secs_f64());
    let ids: Vec<usize> = tokens.iter().map(|&t| if t == Codebooks::NONE { mask.codes } else { t.into() }).collect();
    for quantizer in 1..6 {
        let logits = residual.guided(&ids, quantizer, vector, 5.0);
        let share = agreement(&logits, residual.codes + 1, ids.iter().skip(quantizer).step_by(6).copied());
        println!("  residual {quantizer}: {:.1} % of tokens are the reference's", 100.0 * share);
    }
    Ok(())
}

fn compare_t2mgpt(folder: &Path, vector: &[f32]) -> Result<()> {
    println!("T2M-GPT: VQ 512 wide, 512 codes; transformer 1024 x 18");
    let planner = published::load(&folder.join("t2mgpt_trans.safetensors"), None)?;
    let blob = converted(folder, "t2mgpt_vq.safetensors", &planner, None)?;
    let PublishedPlanner::Gpt(gpt) = &planner else { bail!("another planner than was written") };
    let request = Request::prompt(Prompt::Vector(vector)).sampling(Sampling::Greedy).length(Length::Tokens(50));
    let tokens = run(&blob, &request)?;
    let gpt = Gpt::<f32>::new(gpt);
    let ids: Vec<usize> = tokens.iter().map(|&t| t.into()).collect();
    let begin = Instant::now();
    // Without the class that ends the motion: the length was given.
    let logits = gpt.logits(&ids[..49], vector);
    let rows: Vec<f32> = logits.chunks_exact(gpt.codes + 1).flat_map(|row| &row[..gpt.codes]).copied().collect();
    let share = agreement(&rows, gpt.codes, ids.iter().copied());
    println!(
        "  reference in {:.0} s; {:.1} % of tokens are what it chooses behind the tokens before them",
        begin.elapsed().as_secs_f64(),
        100.0 * share
    );
    Ok(())
}

/// Most memory that the process has had, MB, where the system tells.
fn peak() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(line.split_whitespace().next()?.parse::<u64>().ok()? / 1000)
}

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (folder, which) = match &arguments[..] {
        [folder] => (Path::new(folder), "both"),
        [folder, which] => (Path::new(folder), which.as_str()),
        _ => bail!("give a folder, and momask or t2mgpt for one of them"),
    };
    std::fs::create_dir_all(folder)?;
    let mut stream = Stream::new(9);
    let vector: Vec<f32> = (0..512).map(|_| 2.0 * stream.unit() - 1.0).collect();
    if which != "t2mgpt" {
        momask(folder)?;
        compare_momask(folder, &vector)?;
    }
    if which != "momask" {
        t2mgpt(folder)?;
        compare_t2mgpt(folder, &vector)?;
    }
    if let Some(peak) = peak() {
        println!("most memory of this program, reference and checkpoints included: {peak} MB");
    }
    Ok(())
}
