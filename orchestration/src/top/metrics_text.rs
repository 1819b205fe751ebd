//! Reads a metrics page in the Prometheus text format. Gives its samples, sums over samples, and histogram buckets.

/// A metrics page, read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MetricsPage {
    samples: Vec<Sample>,
}

/// One line of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// Name of the series, with `_bucket`, `_sum` or `_count` for histograms.
    pub name: String,
    /// Its labels.
    pub labels: Vec<(String, String)>,
    /// Its value.
    pub value: f64,
}

impl Sample {
    /// The value of a label.
    pub fn label(&self, name: &str) -> Option<&str> {
        self.labels.iter().find(|(label, _)| label == name).map(|(_, value)| value.as_str())
    }
}

impl MetricsPage {
    /// Reads a page in the Prometheus text format; what is not a sample is left out.
    pub fn parse(text: &str) -> Self {
        Self { samples: text.lines().filter_map(sample).collect() }
    }

    /// The samples of this name whose labels have these values.
    pub fn find<'a>(
        &'a self,
        name: &'a str,
        labels: &'a [(&'a str, &'a str)],
    ) -> impl Iterator<Item = &'a Sample> {
        let fits = |sample: &Sample| labels.iter().all(|(label, value)| sample.label(label) == Some(*value));
        self.samples.iter().filter(move |sample| sample.name == name && fits(sample))
    }

    /// The sum over [`Self::find`]; 0 when there is none.
    pub fn sum(&self, name: &str, labels: &[(&str, &str)]) -> f64 {
        self.find(name, labels).map(|sample| sample.value).sum()
    }

    /// Counts up to each bound of a histogram, all series with these labels together: bounds in ascending order, the last
    /// infinite.
    pub fn buckets(&self, name: &str, labels: &[(&str, &str)]) -> Vec<(f64, f64)> {
        let name = format!("{name}_bucket");
        let mut buckets: Vec<(f64, f64)> = Vec::new();
        for sample in self.find(&name, labels) {
            let Some(bound) = sample.label("le").and_then(|bound| bound.parse::<f64>().ok()) else {
                continue;
            };
            match buckets.iter_mut().find(|(known, _)| *known == bound) {
                Some((_, count)) => *count += sample.value,
                None => buckets.push((bound, sample.value)),
            }
        }
        buckets.sort_by(|a, b| a.0.total_cmp(&b.0));
        buckets
    }
}

fn sample(line: &str) -> Option<Sample> {
    if line.starts_with('#') {
        return None;
    }
    let (series, value) = line.rsplit_once(' ')?;
    let value = value.parse().ok()?;
    let (name, labels) = match series.split_once('{') {
        Some((name, rest)) => (name, labels(rest.strip_suffix('}')?)),
        None => (series, Vec::new()),
    };
    Some(Sample { name: name.to_owned(), labels, value })
}

/// Labels whose values hold no quotes: those of this project are names and numbers.
fn labels(text: &str) -> Vec<(String, String)> {
    let label = |part: &str| {
        let (name, value) = part.split_once("=\"")?;
        Some((name.trim_start_matches(',').to_owned(), value.to_owned()))
    };
    text.split_inclusive('"')
        .collect::<Vec<_>>()
        .chunks(2)
        .filter_map(|pair| label(pair.concat().trim_end_matches('"')))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn samples_are_read_with_their_labels() {
        let page = MetricsPage::parse(
            "# TYPE a counter\na{stage=\"mapper\",reason=\"a, b\"} 3\na{stage=\"mapper\",reason=\"c\"} 4\nb 2.5\nnonsense\n\
             h_bucket{le=\"0.1\"} 1\nh_bucket{le=\"+Inf\"} 4\nh_bucket{le=\"0.1\",x=\"y\"} 1\n",
        );
        assert_eq!(page.sum("a", &[("stage", "mapper")]), 7.0);
        assert_eq!(page.sum("a", &[("stage", "mapper"), ("reason", "a, b")]), 3.0);
        assert_eq!(page.sum("a", &[("stage", "filter")]), 0.0);
        assert_eq!(page.sum("b", &[]), 2.5);
        assert_eq!(page.buckets("h", &[]), [(0.1, 2.0), (f64::INFINITY, 4.0)]);
    }

    proptest! {
        #[test]
        fn any_text_is_survived(text in "[a{}=\", \n0-9#]{0,200}") {
            let page = MetricsPage::parse(&text);
            prop_assert!(page.samples.len() <= text.lines().count());
        }
    }
}
