//! Merging of several pages in the Prometheus text format into one valid page.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

/// One metric with its series, as lines of the text format.
#[derive(Default)]
struct Family<'a> {
    help: Option<&'a str>,
    kind: Option<&'a str>,
    samples: Vec<&'a str>,
}

/// Joins the pages of several stages into one valid page: each metric's HELP and TYPE once, all its series together,
/// metrics in the order of their names. Of a series that appears twice the first is kept; series of a metric that
/// claims another type than before are left out.
pub fn merge_expositions<'a>(pages: impl IntoIterator<Item = &'a str>) -> String {
    let mut families: BTreeMap<&str, Family<'_>> = BTreeMap::new();
    let mut seen: BTreeSet<&str> = BTreeSet::new();
    for page in pages {
        add_page(page, &mut families, &mut seen);
    }
    let mut merged = String::new();
    for (name, family) in families.iter().filter(|(_, family)| !family.samples.is_empty()) {
        write_family(&mut merged, name, family);
    }
    merged
}

fn add_page<'a>(page: &'a str, families: &mut BTreeMap<&'a str, Family<'a>>, seen: &mut BTreeSet<&'a str>) {
    let mut current = "";
    let mut accepted = true;
    for line in page.lines().map(str::trim).filter(|line| !line.is_empty()) {
        if let Some((name, help)) = header(line, "# HELP ") {
            families.entry(name).or_default().help.get_or_insert(help);
        } else if let Some((name, kind)) = header(line, "# TYPE ") {
            accepted = *families.entry(name).or_default().kind.get_or_insert(kind) == kind;
            current = name;
        } else if let Some(series) = series_of(line) {
            let name = series.split('{').next().unwrap_or(series);
            let family = if belongs(name, current) { current } else { name };
            if (accepted || family != current) && seen.insert(series) {
                families.entry(family).or_default().samples.push(line);
            }
        }
    }
}

fn header<'a>(line: &'a str, start: &str) -> Option<(&'a str, &'a str)> {
    let rest = line.strip_prefix(start)?;
    Some(rest.split_once(' ').unwrap_or((rest, "")))
}

/// The name and labels of a sample line, without its value; `None` for comments and lines that are no sample.
fn series_of(line: &str) -> Option<&str> {
    if line.starts_with('#') {
        return None;
    }
    // A label's value may hold blanks and braces, the value behind the last brace may not.
    let end = line.rfind('}').map_or_else(|| line.find(' '), |brace| Some(brace + 1))?;
    line[end..].starts_with(' ').then(|| &line[..end])
}

fn belongs(sample: &str, family: &str) -> bool {
    sample.strip_prefix(family).is_some_and(|rest| matches!(rest, "" | "_bucket" | "_sum" | "_count"))
}

fn write_family(to: &mut String, name: &str, family: &Family<'_>) {
    let written = (|| {
        if let Some(help) = family.help {
            writeln!(to, "# HELP {name} {help}")?;
        }
        if let Some(kind) = family.kind {
            writeln!(to, "# TYPE {name} {kind}")?;
        }
        family.samples.iter().try_for_each(|sample| writeln!(to, "{sample}"))
    })();
    written.expect("a string takes any text");
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::StageMetrics;
    use proptest::prelude::*;

    #[test]
    fn pages_of_several_stages_become_one_valid_page() {
        let pages: Vec<String> = [("mapper", 0), ("mapper", 1), ("scan-matcher", 0)]
            .into_iter()
            .map(|(stage, replica)| {
                let metrics = StageMetrics::new(stage, replica, &["deadline"]);
                metrics.handled(3, 20_000, 30_000);
                metrics.render()
            })
            .collect();
        let merged = merge_expositions(pages.iter().map(String::as_str));
        let types: Vec<&str> = merged.lines().filter(|line| line.starts_with("# TYPE")).collect();
        assert_eq!(types.len(), 11);
        assert!(types.is_sorted());
        assert_eq!(
            merged.lines().filter(|line| line.starts_with("flockslam_scans_handled_total{")).count(),
            3
        );
        let bytes: usize =
            pages.iter().map(|page| page.lines().filter(|l| !l.starts_with('#')).count()).sum();
        assert_eq!(merged.lines().filter(|line| !line.starts_with('#')).count(), bytes);
        // A family's lines stand together, right behind its head.
        let mut current = "";
        for line in merged.lines() {
            match header(line, "# TYPE ") {
                Some((name, _)) => current = name,
                None if line.starts_with('#') => (),
                None => {
                    assert!(belongs(series_of(line).unwrap().split('{').next().unwrap(), current), "{line}")
                }
            }
        }
    }

    #[test]
    fn doubles_and_contradictions_are_left_out() {
        let first = "# HELP a text\n# TYPE a counter\na{x=\"1 }\"} 1\n";
        let second = "# TYPE a gauge\na{x=\"2\"} 5\n";
        let third = "# TYPE a counter\na{x=\"1 }\"} 9\nb 3\n";
        assert_eq!(
            merge_expositions([first, second, third]),
            "# HELP a text\n# TYPE a counter\na{x=\"1 }\"} 1\nb 3\n"
        );
    }

    proptest! {
        #[test]
        fn any_text_is_survived_and_merging_twice_changes_nothing(text in "(# (HELP|TYPE) )?[ab_{}\"# \n]{0,60}") {
            let once = merge_expositions([text.as_str()]);
            let twice = merge_expositions([once.as_str(), once.as_str()]);
            prop_assert_eq!(merge_expositions([twice.as_str()]), twice);
        }
    }
}
