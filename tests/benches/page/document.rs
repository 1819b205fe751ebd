//! The page as a text with sections: reads the page that is kept, replaces the sections that were measured, and writes it again.

use std::collections::BTreeMap;

/// The sections of the page in their order: the name by which `--only` knows them, and the heading.
pub const SECTIONS: [(&str, &str); 14] = [
    ("machine", "Machine"),
    ("accuracy", "Accuracy"),
    ("driving", "Poses that a robot drives by"),
    ("strategies", "Strategies"),
    ("filter", "Filter"),
    ("robustness", "Robustness"),
    ("cost", "Cost"),
    ("front-end", "Front end"),
    ("separation", "Cost of process separation"),
    ("small-computer", "Estimate for a Raspberry Pi 3B+"),
    ("worlds", "Simulated worlds"),
    ("moving", "Moving world"),
    ("movers", "Ghosts, tracks and the published experiment"),
    ("long-run", "Long run"),
];

const INTRODUCTION: &str = "# Benchmarks\n\n\
    Written by `cargo bench -p flockslam --bench page`, which runs the built executable as a user would. Single sections: \
    `… --bench page -- --only accuracy,cost`; the others stay as they are. `--quick` takes one start heading and leaves out what takes minutes. \
    A section ends with the commit that it was measured on; one without is of an older state. \
    The logs are looked for in `FLOCKSLAM_DATA` or `../shared/data`.\n\n\
    Errors over relations: of every relation between two poses that is known from ground truth (R. Kümmerle et al. 2009), how far the \
    estimated motion is off; *short* are relations of less than 60 s, *loops* the others. ATE: absolute error against exact truth after the best \
    rigid alignment, root mean square. Times and memory are of the machine below.\n";

/// The page, section by section.
#[derive(Debug, Default)]
pub struct Page {
    bodies: BTreeMap<&'static str, String>,
}

impl Page {
    /// Takes over the sections of a page that was written before.
    pub fn parse(text: &str) -> Self {
        let mut page = Self::default();
        for part in text.split("\n## ").skip(1) {
            let (heading, body) = part.split_once('\n').unwrap_or((part, ""));
            if let Some((name, _)) = SECTIONS.iter().find(|(_, title)| *title == heading) {
                page.bodies.insert(name, body.trim().to_owned());
            }
        }
        page
    }

    /// Puts a section in the place of what was there.
    ///
    /// # Panics
    /// When no section has this name.
    pub fn set(&mut self, name: &str, body: &str) {
        let (name, _) = SECTIONS.iter().find(|(known, _)| *known == name).expect("the section is known");
        self.bodies.insert(name, body.trim().to_owned());
    }

    /// The whole page as Markdown, every section with its heading.
    pub fn render(&self) -> String {
        let mut text = INTRODUCTION.to_owned();
        for (name, heading) in SECTIONS {
            let body = self.bodies.get(name).map_or("Not measured yet.", String::as_str);
            text += &format!("\n## {heading}\n\n{body}\n");
        }
        text
    }
}
