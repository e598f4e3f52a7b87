//! Makes the table of hard cases from what the tests of them left in a folder.
//!
//! ```text
//! mkdir -p /tmp/stability
//! WARPLIGHT_STABILITY=/tmp/stability cargo test --workspace stability_
//! cargo run -p warplight-tests --example stability -- /tmp/stability > docs/stability.md
//! ```

use std::error::Error;
use std::path::Path;

/// What every test of the table includes; only its rows are needed here.
#[allow(dead_code, unused_imports, unused_macros, reason = "bounds are for tests")]
#[path = "../../protocol/src/stability.rs"]
mod stability;

const HEAD: &str = "\
# Hard cases and their bounds

Where arithmetic is hard, a test states how far it may be off from f64, a closed form or a plain sibling, and how far it was. \
A bound of 0 is of things that must not be: a value that is no number, a leak, a hit that brute force does not find, bytes that \
should be refused. The tests run with all others; an error above its bound ends them.

This table is made by

```
mkdir -p /tmp/stability
WARPLIGHT_STABILITY=/tmp/stability cargo test --workspace stability_
cargo run -p warplight-tests --example stability -- /tmp/stability > docs/stability.md
```
";

/// The processor, as Linux names it.
fn machine() -> String {
    let processors = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = processors.lines().find_map(|line| line.strip_prefix("model name")?.split_once(": "));
    format!("{}, {}", name.map_or("a processor", |(_, name)| name), std::env::consts::OS)
}

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args().nth(1).ok_or("expected the folder that WARPLIGHT_STABILITY named")?;
    let mut lines = Vec::new();
    for entry in std::fs::read_dir(Path::new(&folder))? {
        let path = entry?.path();
        let text = std::fs::read_to_string(&path)?;
        let fields: Vec<&str> = text.trim_end().split('\t').collect();
        let [row, test, quantity, bound, worst] = fields[..] else {
            return Err(format!("{}: expected five fields, found {}", path.display(), fields.len()).into());
        };
        let row: usize = row.parse().map_err(|_| format!("{}: '{row}' is no row", path.display()))?;
        lines.push((row, test.to_owned(), quantity.to_owned(), bound.to_owned(), worst.to_owned()));
    }
    lines.sort();
    println!("{HEAD}\nThe worst values below are of {}.\n", machine());
    println!("| where | quantity | bound | worst seen | test |\n|---|---|---|---|---|");
    for (row, (name, cases)) in stability::ROWS.iter().enumerate() {
        println!("| **{name}**: {cases} | | | | |");
        let of_row: Vec<_> = lines.iter().filter(|line| line.0 == row).collect();
        if of_row.is_empty() {
            return Err(format!("{folder}: no test of '{name}'").into());
        }
        for (_, test, quantity, bound, worst) in of_row {
            println!("| | {quantity} | {bound} | {worst} | `{test}` |");
        }
    }
    Ok(())
}
