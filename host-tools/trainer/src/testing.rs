//! A small dataset for tests: a stick figure that walks, turns and swings its arms, every clip in its own way.

use motionette_host::dataset::{Builder, Caption, Clip, Dataset, Split};
use motionette_host::motion::Pose;
use motionette_host::motion::features::{Options, process};
use motionette_host::motion::skeleton::{PARENTS, REST_DIRECTIONS};

/// `clips` clips of up to `frames` frames, lengths differ. Of six clips in a row the fifth is for validation, the sixth for test.
pub fn dataset(clips: usize, frames: usize) -> Dataset {
    let mut builder = Builder::new();
    for index in 0..clips {
        let split = match index % 6 {
            4 => Split::Val,
            5 => Split::Test,
            _ => Split::Train,
        };
        let length = frames - (index * frames / (2 * clips.max(1)));
        let motion: Vec<Pose> = (0..=length).map(|t| pose(index as f32, t as f32 / 20.0)).collect();
        let processed = process(&motion, &Options::default()).expect("the figure is a motion");
        let clip = Clip {
            id: format!("figure{index}"),
            split,
            subset: "figure".into(),
            source: "test".into(),
            fps_source: 20.0,
            captions: vec![Caption {
                text: format!("a figure walks {}.", ["slowly", "and turns left", "with its right arm"][index % 3]),
                from: 0.0,
                to: 0.0,
                source: "test".into(),
            }],
            labels: serde_json::Value::Null,
            hash: String::new(),
        };
        builder.push(clip, &processed.joints, &processed.features).expect("the figure is finite");
    }
    builder.finish()
}

fn pose(style: f32, seconds: f32) -> Pose {
    let phase = 6.0 * seconds + style;
    let mut pose = [[0.0f32; 3]; 22];
    let heading = 0.3 * (1.0 + style) * seconds;
    let speed = 0.6 + 0.1 * style;
    let (sin, cos) = heading.sin_cos();
    for joint in 1..22 {
        let parent = PARENTS[joint];
        let swing = match joint {
            4 | 7 | 10 => 0.5 * phase.sin(),
            5 | 8 | 11 => -0.5 * phase.sin(),
            18 | 20 => -0.7 * phase.sin(),
            19 | 21 => 0.7 * phase.sin(),
            _ => 0.05 * (phase + joint as f32).sin(),
        };
        let d = REST_DIRECTIONS[joint].map(|x| x as f32);
        let (s, c) = swing.sin_cos();
        let tilted = [d[0], c * d[1] - s * d[2], s * d[1] + c * d[2]];
        let bone = if joint == 1 || joint == 2 { 0.1 } else { 0.25 };
        let turned = [cos * tilted[0] + sin * tilted[2], tilted[1], cos * tilted[2] - sin * tilted[0]];
        for i in 0..3 {
            pose[joint][i] = pose[parent][i] + bone * turned[i];
        }
    }
    let root = [speed * seconds * heading.sin(), 0.9 + 0.02 * (2.0 * phase).sin(), speed * seconds * heading.cos()];
    pose.map(|joint| std::array::from_fn(|i| joint[i] + root[i]))
}
