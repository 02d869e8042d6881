//! Small random models, written byte by byte from `runtime/src/blob/FORMAT.md`, independently of the converter.

use motionette::blob::{
    Activation, Card, Codec, ControlConfig, Corruption, DType, DecoderConfig, Generator, Guidance, HeadConfig, Header,
    HumanMl3d, MAJOR, Manifest, Norm, Padding, PhraseBank, PlannerConfig, PrefixConfig, Representation, ResidualConfig,
    SelfTest, Skeleton, TensorEntry, TextConfig, TextEncoderConfig, TextEncoding, TextLength, TextTable,
    TransformerConfig,
};
use motionette::numerics::hash::{Stream, fnv32};

/// Shape of a small model.
#[derive(Debug, Clone)]
pub struct Shape {
    /// Decoder width.
    pub width: u16,
    /// Code width.
    pub code_width: u16,
    /// Codes.
    pub codes: u16,
    /// Residual quantizers.
    pub quantizers: u8,
    /// Upsampling stages.
    pub stages: u8,
    /// Dilations in order of execution.
    pub dilations: Vec<u8>,
    /// Rows that each of the decoder's convolutions with three taps looks ahead, in order of execution. Empty: its dilation.
    pub right: Vec<u8>,
    /// Leading output rows in int16.
    pub wide: u16,
    /// Longest motion.
    pub max_tokens: u16,
    /// Frames a second.
    pub frame_rate: u16,
    /// Text encoder, stored prompts and planner.
    pub prior: Option<PriorShape>,
    /// A planner that is given a vector, in the prior's place.
    pub prefix: Option<PrefixShape>,
}

/// Shape of a small planner that is given a vector. It stores the prompt `wave`.
#[derive(Debug, Clone, Copy)]
pub struct PrefixShape {
    /// Masked, with a dense head; else a token at a time, with a norm alone.
    pub masked: bool,
    /// Whether it has a planner of further quantizers, of the same blocks.
    pub residual: bool,
    /// Whether all weights have 16 bits, the decoder's too.
    pub wide: bool,
    /// Numbers of a vector.
    pub vector: u16,
    /// Its blocks.
    pub planner: TransformerConfig,
    /// Guidance that it is made for.
    pub guidance: f32,
}

/// Shape of a small planner and what it reads.
#[derive(Debug, Clone)]
pub struct PriorShape {
    /// Words in id order; the first two are reserved. Empty: no text encoder.
    pub words: Vec<&'static str>,
    /// Numbers of a word's vector, a multiple of 16; 0: every word has an embedding. Words with vectors take the order of their hashes.
    pub vectors: u16,
    /// Phrases that a prompt may mean.
    pub phrases: Vec<&'static str>,
    /// How many of them are actions.
    pub actions: u16,
    /// Whether guidance takes one pass.
    pub one_pass: bool,
    /// Names of stored prompts and the rows of their memory.
    pub bank: Vec<(&'static str, u16)>,
    /// Longest prompt.
    pub max_words: u16,
    /// The encoder; its width is also that of stored prompts.
    pub text: TransformerConfig,
    /// The planner.
    pub planner: TransformerConfig,
    /// Whether linears of the planner's blocks have 4-bit weights, where their inputs come in whole groups.
    pub packed: bool,
    /// Whether the blob has a planner at all.
    pub planned: bool,
    /// Anchor control; needs a planner.
    pub control: Option<ControlConfig>,
    /// What the planner makes tokens of.
    pub corruption: Corruption,
}

/// Probability from which a prompt counts as understood.
pub const THRESHOLD: f32 = 0.75;

impl Default for PriorShape {
    fn default() -> Self {
        let text = TransformerConfig {
            width: 12,
            heads: 3,
            layers: 1,
            hidden: 10,
            norm: Norm::Pre,
            activation: Activation::Gelu,
            epsilon: 1e-5,
        };
        PriorShape {
            words: vec!["<none>", "<unknown>", "a", "person", "waves", "run", "left", "hand"],
            vectors: 0,
            phrases: vec![],
            actions: 0,
            one_pass: false,
            bank: vec![("wave", 3), ("stand still", 1)],
            max_words: 7,
            text,
            planner: TransformerConfig { width: 8, heads: 2, layers: 2, hidden: 14, ..text },
            packed: false,
            planned: true,
            control: None,
            corruption: Corruption::Near { c: 3.0, a: 0.9 },
        }
    }
}

impl Default for Shape {
    fn default() -> Self {
        Shape {
            width: 10,
            code_width: 6,
            codes: 11,
            quantizers: 1,
            stages: 2,
            dilations: vec![3, 1],
            right: vec![],
            wide: 4,
            max_tokens: 49,
            frame_rate: 20,
            prior: None,
            prefix: None,
        }
    }
}

impl Shape {
    /// The default with a planner of the default shape.
    #[must_use]
    pub fn with_prior() -> Self {
        Shape { max_tokens: 13, prior: Some(PriorShape::default()), ..Shape::default() }
    }

    /// Dilations of the decoder's convolutions with three taps in order of execution, each with how far it looks ahead.
    #[must_use]
    pub fn convolutions(&self) -> Vec<(u8, u8)> {
        let stages = (0..self.stages).flat_map(|_| self.dilations.iter().copied().chain([1]));
        let dilations: Vec<u8> = [1].into_iter().chain(stages).chain([1, 1]).collect();
        let right = if self.right.is_empty() { dilations.clone() } else { self.right.clone() };
        assert_eq!(dilations.len(), right.len(), "a mistake in the test");
        dilations.into_iter().zip(right).collect()
    }

    /// The same shape whose decoder looks nowhere ahead.
    #[must_use]
    pub fn causal(self) -> Self {
        let right = vec![0; self.convolutions().len()];
        Shape { right, ..self }
    }
}

impl PriorShape {
    /// Widths of whole groups and 4-bit weights; the feed-forward layer's output stays int8.
    #[must_use]
    pub fn packed() -> Self {
        let prior = PriorShape::default();
        let text = TransformerConfig { width: 16, heads: 2, ..prior.text };
        let planner = TransformerConfig { width: 32, heads: 4, hidden: 22, ..prior.planner };
        PriorShape { text, planner, packed: true, ..prior }
    }

    /// The default with masked tokens.
    #[must_use]
    pub fn masked() -> Self {
        PriorShape { corruption: Corruption::Masks, ..PriorShape::default() }
    }

    /// The default with all that came with version 4.1: words with vectors, phrases, guidance in one pass.
    #[must_use]
    pub fn understanding() -> Self {
        let phrases = vec!["a person waves", "a person runs", "a person stands", "a person hops", "angrily", "sadly"];
        PriorShape { vectors: 32, phrases, actions: 4, one_pass: true, ..PriorShape::default() }.hashed()
    }

    /// Words with vectors in the order of their hashes.
    fn hashed(mut self) -> Self {
        self.words.split_at_mut(2).1.sort_by_key(|word| fnv32(word.as_bytes()));
        self
    }

    /// The default with anchor control of all families.
    #[must_use]
    pub fn with_control() -> Self {
        let prior = PriorShape::default();
        let scaffold = TransformerConfig { width: 6, heads: 2, layers: 2, hidden: 9, ..prior.planner };
        let control = ControlConfig { scaffold, frame_width: 5, rank: 3, context: true, families: 7 };
        PriorShape { control: Some(control), ..prior }
    }
}

/// Features of the only representation there is.
pub const FEATURES: u16 = 263;

/// A body whose joints are all 10 cm and their number in millimetres from their parents, straight up.
#[must_use]
pub fn skeleton() -> [u8; 264] {
    let mut bytes = [0; 264];
    for joint in 1..22 {
        let up = (100 + joint) as f32 / 1000.0;
        bytes[12 * joint + 4..12 * joint + 8].copy_from_slice(&up.to_le_bytes());
    }
    bytes
}

/// One convolution with its weights as real numbers, for the oracle.
#[derive(Debug, Clone)]
pub struct Layer {
    /// Kernel size.
    pub taps: usize,
    /// Dilation.
    pub dilation: usize,
    /// Rows that the last tap looks ahead.
    pub right: usize,
    /// Output channels.
    pub outputs: usize,
    /// Input channels.
    pub inputs: usize,
    /// `[taps][outputs][inputs]`, dequantised.
    pub weights: Vec<f64>,
    /// `[outputs]`
    pub biases: Vec<f64>,
}

/// Weight and bias of a normalisation.
pub type NormWeights = (Vec<f64>, Vec<f64>);

/// Embedding rows, `[rows][width]`.
pub type Table = Vec<Vec<f64>>;

/// A transformer block with its weights as real numbers.
#[derive(Debug, Clone)]
pub struct Block {
    /// Before or behind self-attention.
    pub norm1: NormWeights,
    /// Queries, keys, values.
    pub qkv: Layer,
    /// Behind self-attention.
    pub out: Layer,
    /// Norm, queries, keys and values, output of cross-attention.
    pub cross: Option<(NormWeights, Layer, Layer, Layer)>,
    /// Before or behind the feed-forward layer.
    pub norm2: NormWeights,
    /// To the hidden width.
    pub up: Layer,
    /// And back.
    pub down: Layer,
}

/// Text encoder, stored prompts and planner with their weights as real numbers.
#[derive(Debug, Clone)]
pub struct Prior {
    /// Word embeddings, position embeddings, blocks, last norm; `None` without an encoder.
    pub encoder: Option<(Table, Table, Vec<Block>, NormWeights)>,
    /// Length head.
    pub length: Layer,
    /// Pooled vector to a logit a phrase.
    pub meaning: Option<Layer>,
    /// Rows of the strength of guidance.
    pub guidance: Option<Table>,
    /// The row of a masked token.
    pub mask: Option<Table>,
    /// Stored prompts, `[rows + 1][dt]`.
    pub bank: Vec<Table>,
    /// Pooled vector to row 0.
    pub global: Layer,
    /// Time, boundary, position, end, fixed.
    pub tables: [Table; 5],
    /// Blocks.
    pub blocks: Vec<Block>,
    /// Last norm.
    pub norm: NormWeights,
    /// Hidden rows to logits.
    pub token: Layer,
}

/// Anchor control with its weights as real numbers.
#[derive(Debug, Clone)]
pub struct Control {
    /// Mean of the values, `[66]`.
    pub mean: Vec<f64>,
    /// Their deviation, `[66]`.
    pub std: Vec<f64>,
    /// Features of a frame to its width.
    pub frame: Layer,
    /// A token's frames to a row.
    pub merge: Layer,
    /// Position embeddings.
    pub position: Table,
    /// Blocks.
    pub blocks: Vec<Block>,
    /// Last norm.
    pub norm: NormWeights,
    /// For each block of the planner: to the rank, and from there to keys and values.
    pub anchors: Vec<(Layer, Layer)>,
    /// Two layers of the mean row, one of each row.
    pub context: Option<(Layer, Layer, Layer)>,
}

/// A blob and what is in it.
#[derive(Debug, Clone)]
pub struct Tiny {
    /// The shape it was made with.
    pub shape: Shape,
    /// Layers in order of execution.
    pub layers: Vec<Layer>,
    /// `[Q][V][du]`
    pub codes: Vec<f64>,
    /// `[F]`
    pub mean: Vec<f64>,
    /// `[F]`
    pub std: Vec<f64>,
    /// Planner and what it reads.
    pub prior: Option<Prior>,
    /// Anchor control.
    pub control: Option<Control>,
    words: Vec<u128>,
    len: usize,
}

/// A table entry without its name's lifetime.
type Entry = (String, DType, [u16; 3], u32);

struct Writer {
    random: Stream,
    /// Whether linears are to have 4-bit weights.
    packed: bool,
    /// Whether linears and tables are to have weights of 16 bits.
    all_wide: bool,
    entries: Vec<Entry>,
    weights: Vec<u8>,
}

impl Writer {
    fn tensor(&mut self, name: &str, dtype: DType, shape: [u16; 3], bytes: impl IntoIterator<Item = u8>) {
        self.weights.resize(self.weights.len().next_multiple_of(16), 0);
        self.entries.push((name.to_owned(), dtype, shape, self.weights.len() as u32));
        self.weights.extend(bytes);
    }

    fn f32s(&mut self, name: &str, values: &[f32]) {
        self.tensor(name, DType::F32, [1, 1, values.len() as u16], values.iter().flat_map(|v| v.to_le_bytes()));
    }

    /// A number in -1..1.
    fn signed(&mut self) -> f32 {
        2.0 * self.random.unit() - 1.0
    }

    fn int8(&mut self) -> i8 {
        (self.random.below(255) as i32 - 127) as i8
    }

    fn layer(&mut self, name: &str, taps: u16, dilation: u8, outputs: u16, inputs: u16, wide: u16) -> Layer {
        let count = |rows: u16| usize::from(taps) * usize::from(rows) * usize::from(inputs);
        let planes: Vec<i8> = (0..2 * count(wide)).map(|_| self.int8()).collect();
        let packed = self.packed && wide == 0 && inputs.is_multiple_of(16);
        let mut narrow: Vec<i8> = (0..count(outputs - wide)).map(|_| self.int8()).collect();
        if packed {
            narrow.iter_mut().for_each(|w| *w /= 16);
        }
        // Scales that keep the signal's size from layer to layer.
        let step = if packed { 4.3 } else { 73.0 };
        let fan_in = f32::from(taps) * f32::from(inputs);
        let scales: Vec<f32> = (0..outputs)
            .map(|n| (0.5 + self.random.unit()) / fan_in.sqrt() / if n < wide { 73.0 * 256.0 } else { step })
            .collect();
        let biases: Vec<f32> = (0..outputs).map(|_| 0.3 * self.signed()).collect();
        if wide > 0 {
            self.tensor(
                &format!("{name}.wide"),
                DType::I16Planes,
                [taps, wide, inputs],
                planes.iter().map(|&v| v as u8),
            );
        }
        if packed {
            let half = |v: i8| (v + 8) as u8;
            let pack = |g: &[i8]| (0..8).map(|i| half(g[i]) | half(g[8 + i]) << 4).collect::<Vec<_>>();
            self.tensor(name, DType::I4, [taps, outputs, inputs], narrow.chunks(16).flat_map(pack));
        } else if wide < outputs {
            self.tensor(name, DType::I8, [taps, outputs - wide, inputs], narrow.iter().map(|&v| v as u8));
        }
        self.f32s("s", &scales);
        self.f32s("b", &biases);

        let (rows, wide_rows, columns) = (usize::from(outputs), usize::from(wide), usize::from(inputs));
        let mut weights = vec![0.0; usize::from(taps) * rows * columns];
        for tap in 0..usize::from(taps) {
            for n in 0..rows {
                for k in 0..columns {
                    let w = if n < wide_rows {
                        let at = (tap * wide_rows + n) * columns + k;
                        256.0 * f64::from(planes[at]) + f64::from(planes[count(wide) + at])
                    } else {
                        f64::from(narrow[(tap * (rows - wide_rows) + n - wide_rows) * columns + k])
                    };
                    weights[(tap * rows + n) * columns + k] = w * f64::from(scales[n]);
                }
            }
        }
        Layer {
            taps: usize::from(taps),
            dilation: usize::from(dilation),
            right: usize::from(taps / 2) * usize::from(dilation),
            outputs: rows,
            inputs: columns,
            weights,
            biases: biases.iter().map(|&b| f64::from(b)).collect(),
        }
    }
}

impl Writer {
    fn linear(&mut self, name: &str, outputs: u16, inputs: u16) -> Layer {
        let wide = if self.all_wide { outputs } else { 0 };
        self.layer(name, 1, 1, outputs, inputs, wide)
    }

    fn table(&mut self, name: &str, rows: u16, width: u16) -> Table {
        if self.all_wide {
            let columns = usize::from(width);
            let rows = self.layer(name, 1, 1, rows, width, rows);
            // A table has no biases.
            self.entries.pop();
            return rows.weights.chunks(columns).map(<[f64]>::to_vec).collect();
        }
        let (count, columns) = (usize::from(rows) * usize::from(width), usize::from(width));
        let values: Vec<i8> = (0..count).map(|_| self.int8()).collect();
        let scales: Vec<f32> = (0..rows).map(|_| (0.5 + self.random.unit()) / 127.0).collect();
        self.tensor(name, DType::I8, [1, rows, width], values.iter().map(|&v| v as u8));
        self.f32s("s", &scales);
        let rows = values.chunks(columns).zip(&scales);
        rows.map(|(row, s)| row.iter().map(|&v| f64::from(v) * f64::from(*s)).collect()).collect()
    }

    /// Hashes, 4-bit vectors, their scales, two rows of their own, and the layer that makes rows; the rows of all words.
    fn vectors(&mut self, words: &[&str], dims: u16, width: u16) -> Table {
        let known = &words[2..];
        let (rows, columns) = (known.len() as u16, usize::from(dims));
        let hashes = known.iter().flat_map(|word| fnv32(word.as_bytes()).to_le_bytes());
        self.tensor("hashes", DType::U32, [1, 1, rows], hashes);
        let numbers: Vec<i8> = (0..known.len() * columns).map(|_| self.random.below(15) as i8 - 7).collect();
        let half = |v: i8| (v + 8) as u8;
        let pack = |g: &[i8]| (0..8).map(|i| half(g[i]) | half(g[8 + i]) << 4).collect::<Vec<_>>();
        self.tensor("vectors", DType::I4, [1, rows, dims], numbers.chunks(16).flat_map(pack));
        let scales: Vec<u16> = known.iter().map(|_| half_bits(0.1 + 0.2 * self.random.unit())).collect();
        self.tensor("scales", DType::F16, [1, 1, rows], scales.iter().flat_map(|v| v.to_le_bytes()));
        let mut table = self.table("special", 2, width);
        let layer = self.linear("projection", width, dims);
        for (row, scale) in numbers.chunks(columns).zip(scales) {
            let row: Vec<f64> = row.iter().map(|v| f64::from(*v) * half_value(scale)).collect();
            let output = |n: usize| {
                let weights = &layer.weights[n * columns..(n + 1) * columns];
                weights.iter().zip(&row).map(|(w, x)| w * x).sum::<f64>() + layer.biases[n]
            };
            table.push((0..usize::from(width)).map(output).collect());
        }
        table
    }

    fn norm(&mut self, name: &str, width: u16) -> NormWeights {
        let weight: Vec<f32> = (0..width).map(|_| 1.0 + 0.3 * self.signed()).collect();
        let bias: Vec<f32> = (0..width).map(|_| 0.2 * self.signed()).collect();
        self.f32s(name, &weight);
        self.f32s("b", &bias);
        let wide = |values: &[f32]| values.iter().map(|&v| f64::from(v)).collect();
        (wide(&weight), wide(&bias))
    }

    fn block(&mut self, config: &TransformerConfig, memory: Option<u16>) -> Block {
        let d = config.width;
        Block {
            norm1: self.norm("n1", d),
            qkv: self.linear("qkv", 3 * d, d),
            out: self.linear("out", d, d),
            cross: memory.map(|dt| {
                (self.norm("nc", d), self.linear("cq", d, d), self.linear("ckv", 2 * d, dt), self.linear("co", d, d))
            }),
            norm2: self.norm("n2", d),
            up: self.linear("up", config.hidden, d),
            down: self.linear("down", d, config.hidden),
        }
    }

    /// The tensors behind the decoder's, in the order of `FORMAT.md`.
    fn prior(&mut self, shape: &Shape, prior: &PriorShape) -> Prior {
        let dt = prior.text.width;
        let encoder = (!prior.words.is_empty()).then(|| {
            let embedding = match prior.vectors {
                0 => self.table("words", prior.words.len() as u16, dt),
                dims => self.vectors(&prior.words, dims, dt),
            };
            let position = self.table("places", prior.max_words, dt);
            let blocks = (0..prior.text.layers).map(|_| self.block(&prior.text, None)).collect();
            (embedding, position, blocks, self.norm("n", dt))
        });
        let length = self.linear("length", shape.max_tokens, dt);
        let phrases = prior.phrases.len() as u16;
        let meaning = (phrases > 0).then(|| self.linear("meaning", phrases, dt));
        let bank = prior.bank.iter().map(|(name, rows)| {
            let bits: Vec<u16> =
                (0..usize::from(rows + 1) * usize::from(dt)).map(|_| half_bits(2.0 * self.signed())).collect();
            let bytes = bits.iter().flat_map(|v| v.to_le_bytes());
            self.tensor(name, DType::F16, [1, rows + 1, dt], bytes);
            bits.chunks(usize::from(dt)).map(|row| row.iter().map(|&v| half_value(v)).collect()).collect()
        });
        let bank = bank.collect();
        if !prior.planned {
            let none = Layer { taps: 1, dilation: 1, right: 0, outputs: 0, inputs: 0, weights: vec![], biases: vec![] };
            let tables = [vec![], vec![], vec![], vec![], vec![]];
            let norm = (vec![], vec![]);
            return Prior {
                encoder,
                length,
                meaning,
                guidance: None,
                mask: None,
                bank,
                global: none.clone(),
                tables,
                blocks: vec![],
                norm,
                token: none,
            };
        }
        let d = prior.planner.width;
        let global = self.linear("global", d, dt);
        let tables = [
            self.table("time", 32, d),
            self.table("boundary", 4, d),
            self.table("position", shape.max_tokens, d),
            self.table("end", shape.max_tokens, d),
            self.table("fixed", 1, d),
        ];
        let guidance = prior.one_pass.then(|| self.table("guidance", 5, d));
        let mask = (prior.corruption == Corruption::Masks).then(|| self.table("mask", 1, d));
        self.packed = prior.packed;
        let blocks = (0..prior.planner.layers).map(|_| self.block(&prior.planner, Some(dt))).collect();
        self.packed = false;
        let (norm, token) = (self.norm("n", d), self.linear("token", shape.codes, d));
        Prior { encoder, length, meaning, guidance, mask, bank, global, tables, blocks, norm, token }
    }
}

impl Writer {
    /// The tensors of a planner that is given a vector, in the order of `FORMAT.md`.
    fn prefix(&mut self, shape: &Shape, prefix: &PrefixShape) {
        let PrefixShape { masked, residual, wide, vector, planner, .. } = *prefix;
        let bits: Vec<u16> = (0..vector).map(|_| half_bits(2.0 * self.signed())).collect();
        self.tensor("wave", DType::F16, [1, 1, vector], bits.iter().flat_map(|v| v.to_le_bytes()));
        self.all_wide = wide;
        let (d, codes) = (planner.width, shape.codes);
        self.linear("global", d, vector);
        self.table("tokens", codes + u16::from(masked), d);
        self.table("position", shape.max_tokens, d);
        (0..planner.layers).for_each(|_| drop(self.block(&planner, None)));
        if masked {
            self.linear("dense", d, d);
        }
        self.norm("n", d);
        self.linear("token", codes + u16::from(!masked), d);
        if residual {
            let quantizers = u16::from(shape.quantizers);
            self.linear("global", d, vector);
            self.table("quantizer", quantizers, d);
            self.table("position", shape.max_tokens, d);
            (1..quantizers).for_each(|_| drop(self.table("tokens", codes + 1, d)));
            (0..planner.layers).for_each(|_| drop(self.block(&planner, None)));
            self.linear("dense", d, d);
            self.norm("n", d);
            (1..quantizers).for_each(|_| drop(self.linear("token", codes + 1, d)));
        }
        self.all_wide = false;
    }

    /// The tensors behind the planner's.
    fn control(&mut self, shape: &Shape, planner: &TransformerConfig, config: &ControlConfig) -> Control {
        let ControlConfig { scaffold, frame_width, rank, context, .. } = *config;
        let (ds, d) = (scaffold.width, planner.width);
        // Metres: what anchors say varies by decimetres.
        let mean: Vec<f32> = (0..66).map(|_| 0.5 * self.signed()).collect();
        let std: Vec<f32> = (0..66).map(|_| 0.2 + 0.5 * self.random.unit()).collect();
        self.f32s("control.mean", &mean);
        self.f32s("control.std", &std);
        let wide = |values: &[f32]| values.iter().map(|&v| f64::from(v)).collect();
        Control {
            mean: wide(&mean),
            std: wide(&std),
            frame: self.linear("frame", frame_width, 244),
            merge: self.linear("merge", ds, frame_width << shape.stages),
            position: self.table("position", shape.max_tokens, ds),
            blocks: (0..scaffold.layers).map(|_| self.block(&scaffold, None)).collect(),
            norm: self.norm("n", ds),
            anchors: (0..planner.layers)
                .map(|_| (self.linear("down", rank, ds), self.linear("kv", 2 * d, rank)))
                .collect(),
            context: context
                .then(|| (self.linear("in", ds, ds), self.linear("out", d, ds), self.linear("local", d, ds))),
        }
    }
}

impl Tiny {
    /// A model with random weights.
    ///
    /// # Panics
    /// When a shape does not fit the format (a mistake in the test).
    #[must_use]
    pub fn new(shape: Shape, seed: u64) -> Self {
        let (entries, weights) = (Vec::new(), Vec::new());
        let mut writer = Writer { random: Stream::new(seed), packed: false, all_wide: false, entries, weights };
        // Root velocities of a few centimetres and degrees a frame, joints within a metre.
        let std: Vec<f32> =
            (0..FEATURES).map(|c| if c < 4 { 0.02 } else { 0.1 + 0.2 * writer.random.unit() }).collect();
        let mean: Vec<f32> = (0..FEATURES).map(|c| if c < 3 { 0.01 } else { 0.5 * writer.signed() }).collect();
        writer.f32s("mean", &mean);
        writer.f32s("std", &std);
        let mut codes = Vec::new();
        for quantizer in 0..shape.quantizers {
            let book: Vec<u16> = (0..usize::from(shape.codes) * usize::from(shape.code_width))
                .map(|_| half_bits(writer.signed()))
                .collect();
            codes.extend(book.iter().map(|&bits| half_value(bits)));
            let name = format!("quantizer.layers.{quantizer}.codebook");
            let bytes = book.iter().flat_map(|v| v.to_le_bytes());
            writer.tensor(&name, DType::F16, [1, shape.codes, shape.code_width], bytes);
        }
        let width = shape.width;
        let wide = if shape.prefix.is_some_and(|prefix| prefix.wide) { width } else { 0 };
        let mut layers = vec![writer.layer("decoder.model.0", 3, 1, width, shape.code_width, wide)];
        for stage in 0..shape.stages {
            for (block, &dilation) in shape.dilations.iter().enumerate() {
                let name = format!("decoder.model.{}.0.model.{block}", stage + 2);
                layers.push(writer.layer(&format!("{name}.conv1"), 3, dilation, width, width, wide));
                layers.push(writer.layer(&format!("{name}.conv2"), 1, 1, width, width, wide));
            }
            layers.push(writer.layer(&format!("decoder.model.{}.2", stage + 2), 3, 1, width, width, wide));
        }
        layers.push(writer.layer("decoder.middle", 3, 1, width, width, wide));
        layers.push(writer.layer("decoder.output", 3, 1, FEATURES, width, shape.wide));
        for (layer, (_, right)) in layers.iter_mut().filter(|layer| layer.taps == 3).zip(shape.convolutions()) {
            layer.right = usize::from(right);
        }

        let prior = shape.prior.as_ref().map(|prior| writer.prior(&shape, prior));
        if let Some(prefix) = &shape.prefix {
            writer.prefix(&shape, prefix);
        }
        let config = shape.prior.as_ref().and_then(|prior| Some((prior.planner, prior.control?)));
        let control = config.map(|(planner, control)| writer.control(&shape, &planner, &control));
        let (mut vocabulary, mut bank, mut phrases) = (String::new(), String::new(), String::new());
        if let Some(prior) = &shape.prior {
            phrases = prior.phrases.join("\n");
            vocabulary = prior.words.join("\n");
            bank = prior.bank.iter().map(|(name, _)| *name).collect::<Vec<_>>().join("\n");
        }
        let text = shape.prior.as_ref().map(|prior| TextConfig {
            width: prior.text.width,
            max_words: prior.max_words,
            encoder: match (prior.words.is_empty(), prior.vectors) {
                (true, _) => TextEncoding::Stored,
                (false, dims) => TextEncoding::Words(TextEncoderConfig {
                    table: match dims {
                        0 => TextTable::Words(&vocabulary),
                        dims => TextTable::Vectors { words: prior.words.len() as u16 - 2, dims },
                    },
                    transformer: prior.text,
                }),
            },
            length: TextLength::Head,
            bank: match prior.actions {
                0 => PhraseBank::Prompts(&bank),
                actions => PhraseBank::Meanings { prompts: &bank, phrases: &phrases, actions, threshold: THRESHOLD },
            },
        });
        let planner = shape.prior.as_ref().filter(|prior| prior.planned).map(|prior| PlannerConfig {
            max_tokens: shape.max_tokens,
            transformer: prior.planner,
            corruption: prior.corruption,
            guidance: if prior.one_pass { Guidance::OnePass } else { Guidance::TwoPass },
            control: config.map(|(_, control)| control),
        });
        let text = text.or(shape.prefix.map(|prefix| TextConfig {
            width: prefix.vector,
            max_words: 1,
            encoder: TextEncoding::Vectors,
            length: TextLength::Unsaid,
            bank: PhraseBank::Prompts("wave"),
        }));
        let prefix = shape.prefix.map(|prefix| {
            let PrefixShape { masked, residual, planner: transformer, guidance, .. } = prefix;
            let config = PrefixConfig {
                max_tokens: shape.max_tokens,
                transformer,
                head: if masked { HeadConfig::Dense { epsilon: 1e-6 } } else { HeadConfig::Norm },
                guidance,
                residual: residual.then_some(ResidualConfig { transformer, epsilon: 1e-6, guidance }),
            };
            if masked { Generator::Masked(config) } else { Generator::Autoregressive(config) }
        });
        let given = Generator::Given { max_tokens: shape.max_tokens };
        let skeleton = skeleton();
        // Kernel 3 everywhere but behind each dilated convolution.
        let each = |(dilation, right): (u8, u8)| Padding {
            left: 2 * u16::from(dilation) - u16::from(right),
            right: u16::from(right),
        };
        let manifest = Manifest {
            card: Card { name: "tiny", licence: "MIT OR Apache-2.0", data: "random numbers", checkpoint: "" },
            representation: Representation::HumanMl3d(HumanMl3d {
                frame_rate: shape.frame_rate,
                skeleton: Skeleton::new(&skeleton),
            }),
            codec: Codec::Vq(DecoderConfig {
                width,
                code_width: shape.code_width,
                codes: shape.codes,
                quantizers: shape.quantizers,
                stages: shape.stages,
                dilations: shape.dilations.iter().copied().collect(),
                padding: shape.convolutions().into_iter().map(each).collect(),
                features: FEATURES,
            }),
            text,
            generator: planner.map(Generator::Words).or(prefix).unwrap_or(given),
            self_test: SelfTest { seed: 0, tokens: 0, hash: 0 },
            tensor_count: writer.entries.len() as u16,
        };
        let blob = assemble(&manifest, &writer.entries, &writer.weights);
        let mut words = vec![0u128; blob.len().div_ceil(16)];
        for (word, bytes) in words.iter_mut().zip(blob.chunks(16)) {
            let mut whole = [0u8; 16];
            whole[..bytes.len()].copy_from_slice(bytes);
            *word = u128::from_le_bytes(whole);
        }
        let wide = |values: &[f32]| values.iter().map(|&v| f64::from(v)).collect();
        Tiny { layers, codes, mean: wide(&mean), std: wide(&std), prior, control, len: blob.len(), words, shape }
    }

    /// The blob, aligned as a reader needs it.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &bytes_of(&self.words)[..self.len]
    }
}

/// A blob from its parts, with lengths and checksum in place.
///
/// # Panics
/// When the manifest cannot be serialised (it always can).
#[must_use]
pub fn assemble(manifest: &Manifest<'_>, entries: &[Entry], weights: &[u8]) -> Vec<u8> {
    let mut text = postcard::to_stdvec(manifest).expect("manifest serialises");
    for (name, dtype, shape, offset) in entries {
        let entry = TensorEntry { name, dtype: *dtype, shape: *shape, offset: *offset };
        text.extend(postcard::to_stdvec(&entry).expect("entry serialises"));
    }
    let weights_offset = (32 + text.len()).next_multiple_of(16);
    let mut header = Header {
        major: MAJOR,
        // The first that has padding which differs.
        minor: u16::from(manifest.codec.decoder().padding.iter().any(|padding| padding.left != padding.right)),
        total_len: (weights_offset + weights.len()) as u32,
        manifest_len: text.len() as u32,
        weights_offset: weights_offset as u32,
        weights_len: weights.len() as u32,
        crc: 0,
    };
    let mut blob = header.emit().to_vec();
    blob.extend(text);
    blob.resize(weights_offset, 0);
    blob.extend(weights);
    header.crc = Header::checksum(&blob);
    blob[..32].copy_from_slice(&header.emit());
    blob
}

/// Words as bytes in memory order.
fn bytes_of(words: &[u128]) -> &[u8] {
    bytemuck::cast_slice(words)
}

fn half_bits(value: f32) -> u16 {
    half::f16::from_f32(value).to_bits()
}

fn half_value(bits: u16) -> f64 {
    half::f16::from_bits(bits).to_f64()
}
