//! The benchmark page: its generator works, and the page that is kept has every section.

use crate::benchmark::{Page, Plan, SECTIONS, generate};
use std::path::Path;

#[test]
fn sections_are_measured_and_others_kept() {
    let before = "# Benchmarks\n\n## Robustness\n\nas it was\n\n## Cost\n\nto be replaced\n";
    let mut page = Page::parse(before);
    let only = ["machine", "accuracy", "cost", "front-end"].map(str::to_owned).into();
    generate(
        &Plan { only, headings_rad: vec![0.0], patient: false, data: None, simulated_s: 10.0 },
        &mut page,
        |_| Ok::<(), String>(()),
    )
    .unwrap();
    let text = page.render();
    assert!(text.contains("## Robustness\n\nas it was\n"), "{text}");
    assert!(text.contains("## Strategies\n\nNot measured yet.\n"), "{text}");
    assert!(!text.contains("to be replaced") && !text.contains("failed"), "{text}");
    assert!(text.contains("Left out, for want of the log: Intel, FR079, ACES."), "{text}");
    for figure in [
        "copying 64 MiB",
        "| simulated building | off | 100 |",
        "| scan-matcher |",
        "| measured |",
        "| publication |",
    ] {
        assert!(text.contains(figure), "no {figure} in\n{text}");
    }
    assert_eq!(Page::parse(&text).render(), text, "a page that is read back is the same");
}

#[test]
fn the_kept_page_is_whole() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/benchmarks.md");
    let text = std::fs::read_to_string(&path).unwrap();
    assert_eq!(Page::parse(&text).render(), text, "{} is as its generator writes it", path.display());
    for (_, heading) in SECTIONS {
        assert!(text.contains(&format!("\n## {heading}\n")), "no section {heading}");
    }
    for missing in ["Not measured", "failed:", "could not be measured", "Left out"] {
        assert!(!text.contains(missing), "the page says '{missing}'");
    }
}
