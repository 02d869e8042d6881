//! `motionette-train` from outside.

#[cfg(target_os = "linux")]
mod full_device {
    use std::fs::File;
    use std::path::Path;
    use std::process::{Command, Output, Stdio};

    use motionette_host::dataset::{Builder, Clip, Split};
    use motionette_host::motion::{FEATURES, recover};

    /// A dataset of one clip of the test split.
    fn write_dataset(path: &Path) {
        let features: Vec<f32> = (0..60 * FEATURES).map(|i| (i % 23) as f32 / 460.0 - 0.02).collect();
        let joints = recover::joints(&features).expect("whole rows");
        let clip = Clip {
            id: "still".to_owned(),
            split: Split::Test,
            subset: "test".to_owned(),
            source: "test".to_owned(),
            fps_source: 20.0,
            captions: Vec::new(),
            labels: serde_json::Value::Null,
            hash: String::new(),
            facts: None,
        };
        let mut builder = Builder::new();
        builder.push(clip, &joints, &features).expect("rows of a motion");
        builder.finish().save(path).expect("saved");
    }

    /// Measures the shipped tokenizer on the dataset of a folder.
    fn measure(folder: &Path, stdout: Stdio, stderr: Stdio) -> Output {
        let tokenizer = concat!(env!("CARGO_MANIFEST_DIR"), "/../../models/nano.safetensors");
        let child = Command::new(env!("CARGO_BIN_EXE_motionette-train"))
            .args(["tokenizer", "--data", "data.mds", "--json", "--evaluate", tokenizer])
            .current_dir(folder)
            .stdin(Stdio::null())
            .stdout(stdout)
            .stderr(stderr)
            .spawn()
            .expect("the program starts");
        child.wait_with_output().expect("it ends")
    }

    fn full() -> Stdio {
        File::options().write(true).open("/dev/full").expect("a device").into()
    }

    #[test]
    fn output_that_is_lost_is_an_error_and_no_panic() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        write_dataset(&folder.path().join("data.mds"));
        let whole = measure(folder.path(), Stdio::piped(), Stdio::piped());
        let text = String::from_utf8_lossy(&whole.stdout).into_owned();
        assert!(whole.status.success(), "{}", String::from_utf8_lossy(&whole.stderr));
        let facts: serde_json::Value = serde_json::from_str(text.lines().last().expect("a line")).expect("JSON");
        assert_eq!(facts["reports"][0]["clips"], 1, "{text}");

        let lost = measure(folder.path(), full(), Stdio::piped());
        let said = String::from_utf8_lossy(&lost.stderr).into_owned();
        assert_eq!(lost.status.code(), Some(1), "{said}");
        assert!(said.starts_with("error: cannot write to standard output"), "{said}");
        assert!(said.contains("because: No space left") && !said.contains("panicked"), "{said}");
    }

    #[test]
    fn an_error_that_nobody_hears_is_an_error() {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let heard = measure(folder.path(), Stdio::piped(), Stdio::piped());
        let said = String::from_utf8_lossy(&heard.stderr).into_owned();
        assert_eq!(heard.status.code(), Some(1), "{said}");
        assert!(said.starts_with("error: ") && said.contains("data.mds"), "{said}");
        assert_eq!(measure(folder.path(), Stdio::piped(), full()).status.code(), Some(1));
    }
}
