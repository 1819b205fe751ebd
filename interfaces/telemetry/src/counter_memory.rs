//! Counters across restarts: pages of metrics go in, the same pages with the counts of earlier processes come out.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

/// What the processes of stages have counted so far, so that counters go on when another process takes a stage over.
///
/// Fed with the pages that processes serve; a page says by [`crate::names::PROCESS_ID`] which process it is from.
#[derive(Debug, Default)]
pub struct CounterMemory {
    processes: BTreeMap<String, Counted>,
}

/// What the processes of one name have counted.
#[derive(Debug, Default)]
struct Counted {
    /// The present process, as its page names it.
    process: String,
    /// By series, what the processes before it have counted.
    before: BTreeMap<String, f64>,
    /// By series, what it has counted itself.
    present: BTreeMap<String, f64>,
    /// The counters and histograms among its metrics, of all processes so far.
    families: Vec<Family>,
}

/// A metric that is a counter or a histogram.
#[derive(Debug)]
struct Family {
    /// Its HELP and TYPE lines.
    head: String,
    series: BTreeSet<String>,
}

impl CounterMemory {
    /// Takes in a page of the process of this name (`mapper-0`), and gives it back with what its predecessors have counted added.
    pub fn accumulate(&mut self, name: &str, page: &str) -> String {
        let process = process_of(page).unwrap_or_default();
        let counted = self.processes.entry(name.to_owned()).or_default();
        if counted.process != process {
            process.clone_into(&mut counted.process);
            for (series, value) in std::mem::take(&mut counted.present) {
                *counted.before.entry(series).or_default() += value;
            }
        }
        counted.take_in(page)
    }

    /// The counters of a process that does not answer, as they were; `None` when it never has.
    pub fn recall(&self, name: &str) -> Option<String> {
        self.processes.get(name).map(Counted::page)
    }

    /// Names of all processes that have answered so far.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.processes.keys().map(String::as_str)
    }
}

impl Counted {
    fn take_in(&mut self, page: &str) -> String {
        let mut whole = String::with_capacity(page.len() + 64);
        let (mut head, mut family) = (String::new(), None);
        for line in page.lines() {
            if line.starts_with('#') {
                if line.starts_with("# HELP ") {
                    head.clear();
                }
                head.push_str(line);
                head.push('\n');
                if line.starts_with("# TYPE ") {
                    family = is_counted(line).then(|| self.family(std::mem::take(&mut head)));
                }
                push_line(&mut whole, line);
                continue;
            }
            let sample = family.zip(line.rsplit_once(' '));
            let number = sample.and_then(|(at, (series, value))| Some((at, series, value.parse().ok()?)));
            let Some((at, series, value)) = number else {
                push_line(&mut whole, line);
                continue;
            };
            self.count(at, series, value);
            self.write(&mut whole, series);
        }
        self.write_missing(&mut whole);
        whole
    }

    /// Where the family with this head is kept.
    fn family(&mut self, head: String) -> usize {
        if let Some(at) = self.families.iter().position(|family| family.head == head) {
            return at;
        }
        self.families.push(Family { head, series: BTreeSet::new() });
        self.families.len() - 1
    }

    fn count(&mut self, family: usize, series: &str, value: f64) {
        match self.present.get_mut(series) {
            Some(present) => *present = value,
            None => drop(self.present.insert(series.to_owned(), value)),
        }
        let known = &mut self.families[family].series;
        if !known.contains(series) {
            known.insert(series.to_owned());
        }
    }

    /// Series that only predecessors had a reason for.
    fn write_missing(&self, to: &mut String) {
        for family in &self.families {
            let missing = family.series.iter().filter(|series| !self.present.contains_key(*series));
            for (count, series) in missing.enumerate() {
                if count == 0 {
                    to.push_str(&family.head);
                }
                self.write(to, series);
            }
        }
    }

    fn page(&self) -> String {
        let mut page = String::new();
        for family in &self.families {
            page.push_str(&family.head);
            family.series.iter().for_each(|series| self.write(&mut page, series));
        }
        page
    }

    fn write(&self, to: &mut String, series: &str) {
        let of = |counted: &BTreeMap<String, f64>| counted.get(series).copied().unwrap_or(0.0);
        writeln!(to, "{series} {}", of(&self.present) + of(&self.before)).expect("a string takes any text");
    }
}

fn is_counted(type_line: &str) -> bool {
    type_line.ends_with(" counter") || type_line.ends_with(" histogram")
}

fn push_line(to: &mut String, line: &str) {
    to.push_str(line);
    to.push('\n');
}

fn process_of(page: &str) -> Option<&str> {
    let line = page.lines().find(|line| line.starts_with(crate::names::PROCESS_ID.name))?;
    line.rsplit_once(' ').map(|(_, value)| value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn page(process: u32, counted: u64, gauge: u64) -> String {
        format!(
            "# HELP flockslam_a_total what\n# TYPE flockslam_a_total counter\nflockslam_a_total{{stage=\"mapper\"}} {counted}\n\
             # HELP flockslam_g level\n# TYPE flockslam_g gauge\nflockslam_g {gauge}\n\
             # HELP flockslam_stage_process_id which\n# TYPE flockslam_stage_process_id gauge\nflockslam_stage_process_id {process}\n"
        )
    }

    fn value(page: &str, name: &str) -> Option<f64> {
        let line = page.lines().find(|line| line.starts_with(name))?;
        line.rsplit_once(' ')?.1.parse().ok()
    }

    #[test]
    fn counters_go_on_and_gauges_do_not() {
        let mut memory = CounterMemory::default();
        assert_eq!(memory.recall("mapper-0"), None);
        assert_eq!(memory.accumulate("mapper-0", &page(7, 40, 3)), page(7, 40, 3));
        let silent = memory.recall("mapper-0").unwrap();
        assert_eq!((value(&silent, "flockslam_a_total"), value(&silent, "flockslam_g")), (Some(40.0), None));
        assert!(silent.starts_with("# HELP flockslam_a_total what\n# TYPE flockslam_a_total counter\n"));
        assert_eq!(memory.accumulate("mapper-0", &page(8, 2, 1)), page(8, 42, 1));
        // The new process has counted more than the old one ever did.
        assert_eq!(memory.accumulate("mapper-0", &page(9, 100, 1)), page(9, 142, 1));
        assert_eq!(memory.accumulate("mapper-1", &page(10, 5, 1)), page(10, 5, 1));
        assert_eq!(memory.names().collect::<Vec<_>>(), ["mapper-0", "mapper-1"]);
    }

    #[test]
    fn a_reason_that_only_the_predecessor_had_stays() {
        let mut memory = CounterMemory::default();
        let head = "# TYPE a_total counter\n";
        let id = |process| {
            format!("# TYPE flockslam_stage_process_id gauge\nflockslam_stage_process_id {process}\n")
        };
        memory.accumulate("m", &format!("{head}a_total{{reason=\"x\"}} 3\n{}", id(1)));
        let second = memory.accumulate("m", &format!("{head}a_total{{reason=\"y\"}} 4\n{}", id(2)));
        assert!(second.contains("a_total{reason=\"x\"} 3\n") && second.contains("a_total{reason=\"y\"} 4\n"));
        let merged = crate::merge_expositions([second.as_str()]);
        assert_eq!(merged.matches("# TYPE a_total counter").count(), 1, "{merged}");
    }

    proptest! {
        #[test]
        fn a_counter_never_goes_back(lives in prop::collection::vec(prop::collection::vec(0_u64..50, 1..5), 1..6)) {
            let (mut memory, mut shown, mut sum) = (CounterMemory::default(), 0.0, 0.0);
            for (process, increments) in lives.iter().enumerate() {
                let mut counted = 0;
                for increment in increments {
                    counted += increment;
                    let now = value(&memory.accumulate("m", &page(process as u32 + 1, counted, 0)), "flockslam_a_total").unwrap();
                    prop_assert!(now >= shown);
                    shown = now;
                }
                sum += counted as f64;
            }
            prop_assert_eq!(shown, sum);
        }
    }
}
