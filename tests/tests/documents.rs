//! The documents against the tree: what they name is there, and what is there they name.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use warplight_client::measure::Stage;

/// The rows of the table of hard cases.
#[allow(dead_code, unused_imports, unused_macros, reason = "its bounds are for the tests of the crates")]
#[path = "../../protocol/src/stability.rs"]
mod stability;

/// Stages of the data flow, in order.
const STAGES: [&str; 10] =
    ["scene", "effects", "integrator", "frame", "encode", "wire", "decode", "warp", "composite", "report"];

/// Every crate of the workspace and its folder.
const CRATES: [(&str, &str); 4] = [
    ("warplight-protocol", "protocol"),
    ("warplight-server", "server"),
    ("warplight-client", "client"),
    ("warplight-tests", "tests"),
];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn read(path: &str) -> String {
    std::fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// Files below a folder whose names end so, as paths from the root; nothing that was built.
fn files(folder: &str, ending: &str) -> Vec<String> {
    let mut found = Vec::new();
    let entries = std::fs::read_dir(root().join(folder)).unwrap_or_else(|error| panic!("{folder}: {error}"));
    for entry in entries.flatten() {
        let name = entry.file_name().to_string_lossy().into_owned();
        let path = if folder == "." { name.clone() } else { format!("{folder}/{name}") };
        if entry.path().is_dir() {
            if name != "target" && !name.starts_with('.') && folder != "." {
                found.extend(files(&path, ending));
            }
        } else if name.ends_with(ending) {
            found.push(path);
        }
    }
    found.sort();
    found
}

fn documents() -> Vec<String> {
    [".", "docs", "docker"].into_iter().flat_map(|folder| files(folder, ".md")).collect()
}

fn sources() -> Vec<String> {
    CRATES.into_iter().flat_map(|(_, folder)| files(folder, ".rs")).collect()
}

/// A document from the line that starts with `heading` to the next heading of its level or above.
fn section<'a>(document: &'a str, heading: &str) -> &'a str {
    let level = heading.chars().take_while(|&c| c == '#').count();
    let start = document.find(&format!("\n{heading}\n")).unwrap_or_else(|| panic!("there is no '{heading}'")) + 1;
    let behind = start + heading.len();
    let mut end = document.len();
    for upper in 1..=level {
        if let Some(found) = document[behind..].find(&format!("\n{} ", "#".repeat(upper))) {
            end = end.min(behind + found);
        }
    }
    &document[start..end]
}

/// What stands between single backticks, outside of blocks.
fn quoted(document: &str) -> Vec<&str> {
    let mut in_block = false;
    let mut found = Vec::new();
    for line in document.lines() {
        if line.trim_start().starts_with("```") {
            in_block = !in_block;
        } else if !in_block {
            found.extend(line.split('`').skip(1).step_by(2));
        }
    }
    found
}

/// First cells of a table's rows, without backticks.
fn first_cells(section: &str) -> Vec<&str> {
    let rows = section.lines().filter_map(|line| line.strip_prefix("| ")?.split(" | ").next());
    rows.skip(1).map(|cell| cell.trim_matches('`')).collect()
}

/// Words in double quotes of a line.
fn strings(line: &str) -> Vec<&str> {
    line.split('"').skip(1).step_by(2).collect()
}

#[test]
fn every_document_is_there() {
    for path in [
        "README.md",
        "ARCHITECTURE.md",
        "CONTRIBUTING.md",
        "CHANGELOG.md",
        "LICENSE-MIT",
        "LICENSE-APACHE",
        "docs/wire-format.md",
        "docs/scene-format.md",
        "docs/glossary.md",
        "docs/stability.md",
        "docs/references.bib",
        "docker/README.md",
    ] {
        assert!(root().join(path).is_file(), "{path} is missing");
    }
}

#[test]
fn architecture_names_every_crate_and_top_level_module_and_no_other() {
    let members: BTreeSet<String> =
        strings(read("Cargo.toml").lines().find(|line| line.starts_with("members")).unwrap())
            .into_iter()
            .map(str::to_owned)
            .collect();
    assert_eq!(members, CRATES.map(|(_, folder)| folder.to_owned()).into(), "members of the workspace");
    let architecture = read("ARCHITECTURE.md");
    for (name, folder) in CRATES {
        assert!(read(&format!("{folder}/Cargo.toml")).contains(&format!("name = \"{name}\"")));
        let section = section(&architecture, &format!("### {name}"));
        let library = read(&format!("{folder}/src/lib.rs"));
        // Public or not; what only tests have is no part of the program.
        let modules: BTreeSet<&str> = library
            .lines()
            .filter_map(|line| line.trim_start_matches("pub ").strip_prefix("mod ")?.strip_suffix(';'))
            .filter(|&module| module != "testing" && module != "stability")
            .collect();
        let named: Vec<&str> = first_cells(section).into_iter().filter(|cell| !cell.starts_with("---")).collect();
        assert_eq!(BTreeSet::from_iter(named.iter().copied()), modules, "modules of {name}");
        assert_eq!(named.len(), modules.len(), "modules of {name}, each once");
    }
    let headings: Vec<&str> = architecture
        .lines()
        .filter_map(|line| line.strip_prefix("### "))
        .filter(|h| h.starts_with("warplight"))
        .collect();
    assert_eq!(headings, CRATES.map(|(name, _)| name));
}

#[test]
fn architecture_names_every_stage_in_order() {
    let architecture = read("ARCHITECTURE.md");
    assert!(architecture.contains(&STAGES.join(" -> ")));
    let rows = first_cells(section(&architecture, "## Data flow"));
    let rows: Vec<&str> = rows.into_iter().filter(|cell| !cell.starts_with("---")).collect();
    assert_eq!(rows, STAGES);
    let events = Stage::ALL.map(|stage| format!("{stage:?}")).join(", ");
    assert!(architecture.contains(&events), "events of a frame: {events}");
}

#[test]
fn paths_and_programs_that_documents_name_are_there() {
    const TOP: [&str; 8] = ["protocol", "server", "client", "tests", "scenes", "docs", "docker", ".ci"];
    let mut missing = Vec::new();
    for document in documents() {
        for quote in quoted(&read(&document)) {
            let word = quote.split_whitespace().next().unwrap_or_default();
            let is_path = word == quote
                && !word.contains(['<', '*', '{'])
                && word.split_once('/').is_some_and(|(top, _)| TOP.contains(&top));
            if is_path && !root().join(word).exists() {
                missing.push(format!("{document}: `{word}`"));
            }
            let is_crate = CRATES.iter().any(|(name, _)| *name == word) || word == "warplight-protocol-fuzz";
            if word.starts_with("warplight-") && !is_crate {
                missing.push(format!("{document}: `{word}` is no crate"));
            }
        }
    }
    assert!(missing.is_empty(), "{missing:#?}");
}

#[test]
fn links_between_documents_resolve() {
    let mut broken = Vec::new();
    for document in documents() {
        let text = read(&document);
        let folder = Path::new(&document).parent().unwrap();
        for rest in text.split("](").skip(1) {
            let Some((target, _)) = rest.split_once(')') else { continue };
            if target.contains("://") || target.starts_with("mailto:") {
                continue;
            }
            let (path, anchor) = target.split_once('#').unwrap_or((target, ""));
            let path = if path.is_empty() { root().join(&document) } else { root().join(folder).join(path) };
            if !path.exists() {
                broken.push(format!("{document}: {target}"));
            } else if !anchor.is_empty() && path.extension().is_some_and(|extension| extension == "md") {
                let there = std::fs::read_to_string(&path).unwrap();
                if !there.lines().any(|line| line.starts_with('#') && anchor_of(line) == anchor) {
                    broken.push(format!("{document}: {target}: no such heading"));
                }
            }
        }
    }
    assert!(broken.is_empty(), "{broken:#?}");
}

/// The anchor that a heading gets where documents are shown.
fn anchor_of(heading: &str) -> String {
    let kept = heading.trim_start_matches('#').trim().to_lowercase();
    kept.chars()
        .filter(|&c| c.is_alphanumeric() || c == ' ' || c == '-' || c == '_')
        .map(|c| if c == ' ' { '-' } else { c })
        .collect()
}

/// The file in which a test of this path may be: `warplight_server::accel::tests::name` or `messages::name`.
fn sources_of_test<'a>(path: &'a str, sources: &[(String, String)]) -> (Vec<String>, &'a str) {
    let name = path.rsplit("::").next().unwrap_or(path);
    let (first, _) = path.split_once("::").unwrap_or((path, ""));
    let folder = match first.strip_prefix("warplight_") {
        Some(folder) => format!("{folder}/src/"),
        None => format!("/tests/{first}.rs"),
    };
    let holds = |(file, text): &&(String, String)| file.contains(&folder) && text.contains(&format!("fn {name}()"));
    (sources.iter().filter(holds).map(|(file, _)| file.clone()).collect(), name)
}

#[test]
fn the_table_of_hard_cases_has_every_row_and_every_test_within_its_bounds() {
    let table = read("docs/stability.md");
    let sources: Vec<(String, String)> = sources().into_iter().map(|file| (file.clone(), read(&file))).collect();
    let is_row = |line: &&str| line.starts_with("| **");
    let rows: Vec<&str> = table.lines().filter(is_row).collect();
    let expected = stability::ROWS.map(|(name, cases)| format!("| **{name}**: {cases} | | | | |"));
    assert_eq!(rows, expected, "make the table anew: it says how");
    let mut named = BTreeSet::new();
    let mut tests_of_row = 1;
    for line in table.lines().skip_while(|line| !line.starts_with("| **")) {
        if line.starts_with("| **") {
            assert!(tests_of_row > 0, "a row without a test before {line}");
            tests_of_row = 0;
            continue;
        }
        let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
        let [_, quantity, bound, worst, test] = cells[..] else { panic!("five cells: {line}") };
        let number = |text: &str| text.parse::<f64>().unwrap_or_else(|error| panic!("{quantity}: '{text}': {error}"));
        assert!(number(worst) <= number(bound), "{line}");
        let (files, name) = sources_of_test(test.trim_matches('`'), &sources);
        assert!(!files.is_empty(), "{test} is nowhere");
        assert!(
            sources.iter().any(|(_, text)| text.contains(&format!("\"{quantity}\""))),
            "{quantity} is measured nowhere"
        );
        named.insert(name.to_owned());
        tests_of_row += 1;
    }
    assert!(tests_of_row > 0, "the last row has no test");
    // And the other way round: a test of a hard case is in the table.
    let written: BTreeSet<String> = sources
        .iter()
        .flat_map(|(_, text)| text.split("fn stability_").skip(1))
        .filter_map(|rest| rest.split_once("() {"))
        .map(|(name, _)| format!("stability_{name}"))
        .filter(|name| name.chars().all(|letter| letter.is_ascii_lowercase() || letter == '_'))
        .collect();
    assert_eq!(written, named, "make the table anew: it says how");
}

#[test]
fn the_clock_is_read_only_where_architecture_says() {
    let architecture = read("ARCHITECTURE.md");
    let section = section(&architecture, "## Where time enters");
    let list: String = section.lines().filter(|line| line.starts_with("- ")).collect();
    let named: BTreeSet<String> =
        quoted(&list).into_iter().filter(|quote| quote.ends_with(".rs")).map(str::to_owned).collect();
    let folders = ["protocol/src", "server/src", "client/src"];
    let reading: BTreeSet<String> = folders
        .into_iter()
        .flat_map(|folder| files(folder, ".rs"))
        .filter(|path| {
            let source = read(path);
            ["Instant::now", "SystemTime::now", "UNIX_EPOCH", "tokio::time::sleep", "thread::sleep"]
                .iter()
                .any(|clock| source.contains(clock))
        })
        .collect();
    assert_eq!(reading, named);
}

#[test]
fn every_dependency_has_its_reason() {
    let manifest = read("Cargo.toml");
    let (_, rest) = manifest.split_once("[workspace.dependencies]\n").unwrap();
    let (dependencies, _) = rest.split_once("\n[").unwrap();
    let dependencies: BTreeSet<&str> = dependencies
        .lines()
        .filter_map(|line| line.split_once(" = "))
        .map(|(name, _)| name)
        .filter(|name| !name.starts_with("warplight-"))
        .collect();
    let contributing = read("CONTRIBUTING.md");
    let rows = first_cells(section(&contributing, "## Dependencies"));
    let explained: Vec<&str> = rows.into_iter().filter(|cell| !cell.starts_with("---")).collect();
    assert_eq!(BTreeSet::from_iter(explained.iter().copied()), dependencies);
    assert!(explained.is_sorted(), "dependencies are in alphabetical order");
    let used: String = CRATES.iter().map(|(_, folder)| read(&format!("{folder}/Cargo.toml"))).collect();
    for name in dependencies {
        assert!(used.contains(&format!("{name}.workspace = true")), "{name} is used by no crate");
    }
}

#[test]
fn the_glossary_is_sorted_and_its_words_are_used() {
    let glossary = read("docs/glossary.md");
    let mut terms = Vec::new();
    for line in glossary.lines().skip(3).filter(|line| !line.is_empty()) {
        let term = line.strip_prefix("- **").and_then(|rest| rest.split_once("**: "));
        let (term, meaning) = term.unwrap_or_else(|| panic!("expected '- **term**: meaning.', found '{line}'"));
        assert!(meaning.ends_with('.') && meaning.len() > 10, "{line}");
        terms.push(term.to_lowercase());
    }
    assert!(terms.len() > 20);
    for pair in terms.windows(2) {
        assert!(pair[0] < pair[1], "'{}' stands before '{}'", pair[0], pair[1]);
    }
    let plain = |text: &str| text.to_lowercase().replace(['_', '-'], " ");
    let mut texts = sources();
    texts.extend(documents());
    texts.retain(|path| !path.ends_with("documents.rs") && !path.ends_with("glossary.md"));
    let used: String = texts.iter().map(|path| plain(&read(path))).collect();
    let unused: Vec<&String> = terms.iter().filter(|term| !used.contains(&plain(term))).collect();
    assert!(unused.is_empty(), "words that nothing uses: {unused:?}");
}

/// Words of all comments, in order.
fn words_of_comments() -> Vec<String> {
    let mut words = Vec::new();
    for path in sources() {
        let source = read(&path);
        let comments = source.lines().filter_map(|line| line.split_once("//"));
        for (_, comment) in comments {
            words.extend(comment.trim_start_matches(['/', '!']).split_whitespace().map(str::to_owned));
        }
    }
    words
}

fn bare(word: &str) -> &str {
    word.trim_matches(|c: char| !c.is_alphanumeric())
}

/// Authors and years that comments cite: `Kajiya 1986`, `Woop et al. 2013`, `Shirley and Wang 1996`.
fn citations(words: &[String]) -> BTreeSet<(String, String)> {
    let mut found = BTreeSet::new();
    for (at, word) in words.iter().enumerate().skip(3) {
        let year = bare(word);
        let is_year = year.len() == 4 && year.parse().is_ok_and(|year: u32| (1900..2030).contains(&year));
        let by = if words[at - 1] == "al." { &words[at - 3] } else { &words[at - 1] };
        let name = bare(by);
        let is_name = name.len() > 2 && name.starts_with(char::is_uppercase) && name.chars().all(char::is_alphabetic);
        if is_year && is_name && !by.ends_with('.') {
            found.insert((name.to_owned(), year.to_owned()));
        }
    }
    found
}

#[test]
fn what_the_code_cites_is_in_the_references_and_nothing_else() {
    struct Entry {
        key: String,
        authors: String,
        year: String,
    }
    let bibliography = read("docs/references.bib");
    let field = |entry: &str, name: &str| {
        let value = entry.split_once(&format!("  {name} = {{"))?.1.split("}\n").next()?.trim_end_matches(['}', ',']);
        Some(value.split("},\n").next().unwrap_or(value).trim_matches(['{', '}', ',']).to_owned())
    };
    let entries: Vec<Entry> = bibliography
        .split("\n@")
        .skip(1)
        .map(|entry| Entry {
            key: entry.split_once('{').unwrap().1.split_once(',').unwrap().0.to_owned(),
            authors: field(entry, "author").unwrap(),
            year: field(entry, "year").unwrap_or_default(),
        })
        .collect();
    assert!(entries.is_sorted_by_key(|entry| &entry.key), "entries are in the order of their keys");
    let words = words_of_comments();
    let cited = citations(&words);
    assert!(cited.len() > 20, "{cited:?}");
    let surname_of_key = |key: &str| key.split(|c: char| !c.is_alphabetic()).next().unwrap_or_default().to_owned();
    for (name, year) in &cited {
        let known = entries.iter().any(|entry| {
            entry.year == *year && (entry.authors.contains(name) || surname_of_key(&entry.key) == name.to_lowercase())
        });
        assert!(known, "{name} {year} is cited, and not in docs/references.bib");
    }
    let words: BTreeSet<String> = words.iter().map(|word| bare(word).to_lowercase()).collect();
    for entry in &entries {
        let first = entry.authors.split([',', ' ']).next().unwrap_or_default().to_lowercase();
        let is_cited = words.contains(&first) || words.contains(&surname_of_key(&entry.key));
        assert!(is_cited, "{} is in docs/references.bib, and cited nowhere", entry.key);
    }
}

/// Arguments of a program as a JSON-like list of strings: `["serve", "--scene", "gallery"]`.
fn assert_flags_are_known(file: &str, arguments: &[&str]) {
    let source = match arguments.first() {
        Some(&"serve") => read("server/src/cli/serve.rs"),
        Some(&"replay") => read("client/src/cli/replay.rs"),
        command => panic!("{file}: no such command: {command:?}"),
    };
    for flag in arguments.iter().filter_map(|argument| argument.strip_prefix("--")) {
        let field = format!(" {}: ", flag.replace('-', "_"));
        assert!(source.contains(&field), "{file}: {} has no --{flag}", arguments[0]);
    }
}

#[test]
fn images_are_built_from_what_is_there() {
    for program in ["warplight-server", "warplight-client"] {
        let file = format!("docker/Dockerfile.{}", program.trim_start_matches("warplight-"));
        let text = read(&file);
        let mut copied = Vec::new();
        for line in text.lines() {
            if let Some(paths) = line.strip_prefix("COPY ").filter(|paths| !paths.starts_with("--from")) {
                let paths: Vec<&str> = paths.split_whitespace().collect();
                copied.extend_from_slice(&paths[..paths.len() - 1]);
            }
            if let Some(arguments) = line.strip_prefix("CMD ") {
                assert_flags_are_known(&file, &strings(arguments));
            }
        }
        for path in &copied {
            assert!(root().join(path).exists(), "{file}: COPY {path}");
        }
        for (_, folder) in CRATES {
            assert!(copied.contains(&folder), "{file}: cargo needs the manifest of {folder}");
        }
        assert!(text.contains(&format!("--package {program} --bin {program}")), "{file}");
        assert!(text.contains(&format!("/target/release/{program} /usr/local/bin/{program}")), "{file}");
        assert!(text.contains(&format!("ENTRYPOINT [\"{program}\"]")), "{file}");
        let user = text.rfind("\nUSER warplight\n");
        assert!(user > text.rfind("\nFROM "), "{file}: does not run as root");
        for allowed in read(&format!("{file}.dockerignore")).lines().filter_map(|line| line.strip_prefix('!')) {
            assert!(copied.contains(&allowed), "{file}: COPY knows no {allowed}");
        }
    }
}

#[test]
fn the_compose_file_names_images_and_flags_that_are_there() {
    let compose = read("docker/compose.yaml");
    assert!(!compose.contains('\t'), "YAML is indented with spaces");
    let value = |line: &str, key: &str| line.trim().strip_prefix(key).map(|value| value.trim().to_owned());
    let dockerfiles: Vec<String> = compose.lines().filter_map(|line| value(line, "dockerfile:")).collect();
    assert_eq!(dockerfiles, ["docker/Dockerfile.server", "docker/Dockerfile.client"]);
    let commands: Vec<String> = compose.lines().filter_map(|line| value(line, "command:")).collect();
    assert_eq!(commands.len(), 2);
    for command in commands {
        assert_flags_are_known("docker/compose.yaml", &strings(&command));
    }
}

#[test]
fn what_must_pass_contains_the_test_command_of_the_readme() {
    const COMMAND: &str = "cargo test --workspace";
    assert!(
        read("README.md")
            .lines()
            .any(|line| line.trim_matches(['`', ' ']).starts_with(COMMAND) || line.contains(&format!("`{COMMAND}`")))
    );
    assert!(read(".ci/run").lines().any(|line| line.trim().starts_with(COMMAND)));
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        let mode = std::fs::metadata(root().join(".ci/run")).unwrap().permissions().mode();
        assert_eq!(mode & 0o111, 0o111, ".ci/run can be executed");
    }
}
