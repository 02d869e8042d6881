//! A folder in which the program runs.

use std::path::PathBuf;
use std::process::{Command, Output};

use motionette_host::dataset::{Builder, Caption, Clip, Split};
use motionette_host::motion::recover;
use serde_json::Value;

use super::Random;
use super::checkpoints::{self, prior_config, prior_metadata, tokenizer_metadata};

const BANK: &str = "# two prompts\nwave\ta person waves\n\nfly\tA person flying!\n";

/// A folder with a tokenizer, three priors of its tokens, one of them of masked ones, and a bank file.
pub struct Bench {
    /// Deleted with the bench.
    pub folder: tempfile::TempDir,
}

impl Bench {
    /// The folder with its files.
    pub fn new() -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let bench = Self { folder };
        // Joints within a metre, whatever the tokens.
        let mut tokenizer = checkpoints::tokenizer();
        let mut std = tokenizer.find("std").expect("std").clone();
        std.data.iter_mut().for_each(|s| *s = 0.05);
        tokenizer.insert("std", std);
        let metadata = tokenizer_metadata(checkpoints::TOKENIZER);
        bench.write("t.safetensors", &checkpoints::bytes(&tokenizer, metadata));
        for (name, norm, activation) in [("p", "pre", "gelu"), ("post", "post", "relu")] {
            let metadata = prior_metadata(&prior_config(norm, activation));
            bench.write(&format!("{name}.prior.safetensors"), &checkpoints::bytes(&checkpoints::prior(5), metadata));
        }
        let masked = checkpoints::bytes(&checkpoints::masked(5), prior_metadata(&checkpoints::masked_config()));
        bench.write("m.prior.safetensors", &masked);
        bench.write("bank.txt", BANK.as_bytes());
        bench
    }

    /// Where a file of the folder lies.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Writes a file.
    pub fn write(&self, name: &str, bytes: &[u8]) {
        std::fs::write(self.path(name), bytes).expect("written");
    }

    /// Runs the program with `--json`.
    pub fn run(&self, arguments: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_motionette"))
            .args(arguments)
            .arg("--json")
            .current_dir(self.folder.path())
            .output()
            .expect("the program starts")
    }

    /// Runs a line of words that must succeed; gives the report.
    pub fn succeeds(&self, line: &str) -> Value {
        self.makes(&line.split_whitespace().collect::<Vec<_>>())
    }

    /// The same with arguments.
    pub fn makes(&self, arguments: &[&str]) -> Value {
        let output = self.run(arguments);
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        report(&output)
    }

    /// Fails with status 1 and says all of `words`; nothing was written to `x`.
    pub fn fails(&self, arguments: &[&str], words: &[&str]) {
        let output = self.run(arguments);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {said}");
        assert!(said.starts_with("error: ") && !said.contains("panicked"), "{said}");
        for word in words {
            assert!(said.contains(word), "{word:?} not in: {said}");
        }
        super::says_each_cause_once(&report(&output), &said);
        assert!(!self.path("x").exists(), "{arguments:?} left something behind");
    }

    /// Fails with status 2: the arguments make no sense.
    pub fn misused(&self, line: &str, word: &str) {
        let output = self.run(&line.split_whitespace().collect::<Vec<_>>());
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{line}: {said}");
        assert!(said.contains(word), "{word:?} not in: {said}");
    }

    /// Makes `p.blob`.
    pub fn convert(&self) {
        self.succeeds("convert t.safetensors --prior p.prior.safetensors --bank bank.txt -o p.blob");
    }

    /// Makes `d.mds`: random clips of 60 frames, two of them with captions that the prior reads.
    pub fn dataset(&self) {
        let mut random = Random(3);
        let mut builder = Builder::new();
        for (id, captions) in [("silent", &[][..]), ("a", &["a person walks"]), ("b", &["zebra", "the person waves"])] {
            let features: Vec<f32> = (0..60 * 263).map(|_| 0.05 * random.uniform() as f32).collect();
            let joints = recover::joints(&features).expect("whole rows");
            let caption = |text: &&str| Caption { text: (*text).to_owned(), from: 0.0, to: 0.0, source: "test".into() };
            let clip = Clip {
                id: id.to_owned(),
                split: Split::Test,
                subset: "test".to_owned(),
                source: "random numbers".to_owned(),
                fps_source: 20.0,
                captions: captions.iter().map(caption).collect(),
                labels: Value::Null,
                facts: None,
                hash: String::new(),
            };
            builder.push(clip, &joints, &features).expect("rows of a motion");
        }
        builder.finish().save(self.path("d.mds")).expect("saved");
    }
}

/// The object on the last line of standard output.
pub fn report(output: &Output) -> Value {
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    serde_json::from_str(text.lines().last().unwrap_or_default()).unwrap_or_else(|e| panic!("{e}: {text}"))
}

/// A list of texts.
pub fn list(value: &Value) -> Vec<String> {
    value.as_array().expect("a list").iter().map(|v| v.as_str().expect("text").to_owned()).collect()
}
