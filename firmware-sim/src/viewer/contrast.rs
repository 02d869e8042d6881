//! Whether the page's colours can be told apart, by the formula of WCAG 2.2 (relative luminance, contrast ratio).

use std::collections::BTreeMap;

const STYLE: &str = include_str!("page/style.css");
/// What text needs (level AA).
const TEXT: f64 = 4.5;
/// What lines and marks that mean something need.
const GRAPHICS: f64 = 3.0;
/// What text and marks stand on.
const SURFACES: [&str; 5] = ["bg", "bg2", "panel", "button", "hover"];

type Palette = BTreeMap<String, [f64; 3]>;

/// The custom properties of the first rule that `selector` begins.
fn palette(selector: &str) -> Palette {
    let rule = STYLE.split(&format!("{selector} {{")).nth(1).and_then(|rest| rest.split('}').next()).expect(selector);
    let declarations =
        rule.split(';').filter_map(|declaration| declaration.trim().strip_prefix("--")?.split_once(": #"));
    let colour = |hex: &str| {
        let channel = |k: usize| f64::from(u8::from_str_radix(&hex[k..k + 2], 16).expect(hex)) / 255.0;
        [channel(0), channel(2), channel(4)]
    };
    declarations.map(|(name, hex)| (name.to_owned(), colour(hex))).collect()
}

fn luminance(colour: [f64; 3]) -> f64 {
    let [r, g, b] = colour.map(|v| if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) });
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

fn contrast(a: [f64; 3], b: [f64; 3]) -> f64 {
    let (a, b) = (luminance(a), luminance(b));
    (a.max(b) + 0.05) / (a.min(b) + 0.05)
}

/// The names in `var(--NAME)` of every declaration of `property`.
fn used<'s>(rule: &'s str, property: &str) -> Vec<&'s str> {
    let declarations = rule.split([';', '{']).map(str::trim);
    let values = declarations.filter_map(|d| d.strip_prefix(property)?.trim_start().strip_prefix(':'));
    values.filter_map(|value| value.trim().strip_prefix("var(--")?.split(')').next()).collect()
}

#[test]
fn formula_of_known_pairs() {
    let grey = |v: u8| [f64::from(v) / 255.0; 3];
    assert!((contrast(grey(0), grey(255)) - 21.0).abs() < 1e-9);
    // The lightest grey that passes on white.
    assert!(contrast(grey(118), grey(255)) > TEXT && contrast(grey(119), grey(255)) < TEXT);
}

#[test]
fn text_and_marks_stand_out_in_both_themes() {
    for theme in [":root", ":root[data-theme=\"light\"]"] {
        let palette = palette(theme);
        assert_eq!(palette.len(), 16, "{theme}: {palette:?}");
        let colour = |name: &str| palette[name];
        let mut texts = Vec::new();
        for rule in STYLE.split('}') {
            let (inks, grounds) = (used(rule, "color"), used(rule, "background"));
            match (&inks[..], &grounds[..]) {
                // A rule that says both says on what.
                ([ink], [ground]) => {
                    let found = contrast(colour(ink), colour(ground));
                    assert!(found >= TEXT, "{theme}: {ink} on {ground} has {found:.2}");
                }
                _ => texts.extend(inks),
            }
            texts.extend(used(rule, "fill").into_iter().filter(|_| rule.contains("text")));
            for line in used(rule, "stroke").into_iter().filter(|line| *line != "line") {
                for ground in SURFACES {
                    let found = contrast(colour(line), colour(ground));
                    assert!(found >= GRAPHICS, "{theme}: a line of {line} on {ground} has {found:.2}");
                }
            }
        }
        for name in ["accent", "target", "before", "alone", "fault", "dim", "text"] {
            assert!(texts.contains(&name), "{name} is a colour of text: {texts:?}");
        }
        // The row of the anchor that is being met: its mark's colour, thinned.
        let now = STYLE.contains("tr.now td { background: color-mix(in srgb, var(--target) 16%, transparent); }");
        assert!(now, "the mixture is another: change it here as well");
        let row = [0, 1, 2].map(|k| 0.16 * colour("target")[k] + 0.84 * colour("panel")[k]);
        for ink in texts {
            let grounds = SURFACES.map(|name| (name, colour(name))).into_iter().chain([("the row", row)]);
            for (ground, at) in grounds.filter(|(ground, _)| *ground != ink) {
                let found = contrast(colour(ink), at);
                assert!(found >= TEXT, "{theme}: {ink} on {ground} has {found:.2}");
            }
        }
        // Swatches and the canvas: bodies, trails, anchors, and the label of the anchor that is being met.
        for mark in ["accent", "target", "before", "alone", "robot", "reference", "fault", "span"] {
            for ground in SURFACES {
                let found = contrast(colour(mark), colour(ground));
                assert!(found >= GRAPHICS, "{theme}: {mark} on {ground} has {found:.2}");
            }
        }
        let ink = if theme == ":root" { "bg" } else { "bg2" };
        assert!(contrast(colour(ink), colour("target")) >= TEXT, "{theme}: the label of an anchor");
    }
}
