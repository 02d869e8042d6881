//! Line diagrams as SVG.
//!
//! Why not a library: lines are all that is drawn. With a third kind of plot a plotting library is the smaller thing.

const COLOURS: [&str; 6] = ["#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#ff7f0e", "#8c564b"];

/// A line of a diagram.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// What it shows.
    pub name: String,
    /// Steps and values.
    pub points: Vec<(u64, f64)>,
}

/// One diagram.
#[derive(Clone, Debug, PartialEq)]
pub struct Panel {
    /// What its values are, with their unit.
    pub title: &'static str,
    /// Its lines.
    pub lines: Vec<Line>,
}

/// Diagrams one below the other, each with its title, `steps` steps along the bottom.
pub fn document(steps: u64, panels: &[Panel]) -> String {
    let height = 270 * panels.len() + 20;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 720 {height}\" font-family=\"sans-serif\" font-size=\"12\">\n\
         <rect width=\"720\" height=\"{height}\" fill=\"white\"/>\n",
    );
    for (index, panel) in panels.iter().enumerate() {
        svg += &diagram(20.0 + 270.0 * index as f64, panel, steps);
    }
    svg + "</svg>\n"
}

/// One diagram, 250 high, its values on a logarithmic axis.
fn diagram(top: f64, panel: &Panel, steps: u64) -> String {
    let (left, width, height) = (60.0, 500.0, 200.0);
    let Panel { title, lines } = panel;
    let values = lines.iter().flat_map(|line| line.points.iter().map(|p| p.1)).filter(|v| *v > 0.0);
    let low = values.clone().fold(f64::INFINITY, f64::min);
    let high = values.fold(0.0f64, f64::max);
    if !low.is_finite() {
        return String::new();
    }
    let (low, high) = (low.ln(), high.ln().max(low.ln() + 0.1));
    let x = |step: u64| left + width * step as f64 / steps as f64;
    let y = |value: f64| top + 25.0 + height * (high - value.max(1e-12).ln()) / (high - low);
    let mut svg = format!("<text x=\"{left}\" y=\"{}\" font-weight=\"bold\">{title}</text>\n", top + 12.0);
    for tick in 0..=4 {
        let value = (low + (high - low) * f64::from(tick) / 4.0).exp();
        let (from, to, at) = (left, left + width, y(value));
        svg += &format!("<path d=\"M{from} {at:.1}H{to}\" stroke=\"#ddd\"/>\n");
        svg += &format!("<text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{value:.3}</text>\n", left - 6.0, at + 4.0);
        let step = steps * tick as u64 / 4;
        svg +=
            &format!("<text x=\"{:.1}\" y=\"{}\" text-anchor=\"middle\">{step}</text>\n", x(step), top + 45.0 + height);
    }
    for (index, Line { name, points }) in lines.iter().enumerate() {
        let colour = COLOURS[index % COLOURS.len()];
        let path: Vec<String> =
            points.iter().map(|(step, value)| format!("{:.1},{:.1}", x(*step), y(*value))).collect();
        svg += &format!(
            "<polyline points=\"{}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.5\"/>\n",
            path.join(" ")
        );
        let at = top + 40.0 + 18.0 * index as f64;
        svg += &format!("<text x=\"{}\" y=\"{at}\" fill=\"{colour}\">{name}</text>\n", left + width + 12.0);
    }
    svg
}
