//! The layers of the source: a module names only the modules that are below it.
//!
//! The table is the map of ARCHITECTURE.md and of the library's front page. The test reads the sources and
//! looks at each `crate::NAME`, outside comments and the tests.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// A group of modules. Each of them may name those before it in the group, and all modules of the groups
/// `below`.
struct Layer {
    name: &'static str,
    modules: &'static [&'static str],
    below: &'static [&'static str],
}

const LAYERS: [Layer; 4] = [
    Layer {
        name: "ground",
        modules: &[
            "error",
            "memory",
            "progress",
            "parallel",
            "units",
            "option_text",
            "names",
            "geometry",
            "files",
            "comm",
            "grid_file",
            "image",
            "mesh",
            "mesh_file",
            "surface_file",
            "well_file",
        ],
        below: &[],
    },
    Layer {
        name: "mesher",
        modules: &[
            "feature",
            "lattice",
            "published",
            "improve",
            "report",
            "job",
        ],
        below: &["ground"],
    },
    Layer {
        name: "uses",
        modules: &["store", "model", "export"],
        below: &["ground"],
    },
    Layer {
        name: "roof",
        modules: &["edit", "assess", "surfaces", "session", "workbench", "cli"],
        below: &["ground", "mesher", "uses"],
    },
];

/// Modules in which any file may name `comm`: the communicators, and the driver of distributed jobs.
const MODULES_WITH_RANKS: [&str; 2] = ["comm", "job"];

/// The other files that may name `comm`, in the order of their paths: distributed data structures, which
/// keep the communicator to themselves, and the command line, which hands it to the job.
const FILES_WITH_RANKS: [&str; 15] = [
    "cli/mod.rs",
    "cli/verbs/mesh.rs",
    "feature/shared_grid/candidate_slab.rs",
    "feature/shared_grid/distributed_points.rs",
    "feature/shared_grid/mod.rs",
    "image/sparse_field.rs",
    "improve/tets/shared_work.rs",
    "improve/tets/slabs/distributed.rs",
    "lattice/distance/distributed_distance.rs",
    "lattice/halo.rs",
    "lattice/owned_atoms.rs",
    "lattice/seeding/shared_box.rs",
    "mesh/delaunay/distributed.rs",
    "mesh/view.rs",
    "session/job.rs",
];

/// Returns all modules, in the order of the table.
fn all_modules() -> impl Iterator<Item = &'static str> {
    LAYERS.iter().flat_map(|layer| layer.modules).copied()
}

/// Returns `true` if the module `user` may name the module `used`.
fn may_name(user: &str, used: &str) -> bool {
    let place = |module: &str| {
        LAYERS.iter().find_map(|layer| {
            let index = layer.modules.iter().position(|name| *name == module)?;
            Some((layer, index))
        })
    };
    let (Some((layer, index)), Some((used_layer, used_index))) = (place(user), place(used)) else {
        return false;
    };
    if layer.name == used_layer.name {
        used_index <= index
    } else {
        layer.below.contains(&used_layer.name)
    }
}

fn is_name_character(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// Returns a copy of a source in which comments and literals are blank. Lines keep their numbers.
fn without_comments(source: &str) -> String {
    let text: Vec<char> = source.chars().collect();
    let mut code = String::with_capacity(source.len());
    let mut i = 0;
    while i < text.len() {
        let next = text.get(i + 1).copied().unwrap_or(' ');
        let begins_word = i == 0 || !is_name_character(text[i - 1]);
        let end = match (text[i], next) {
            ('/', '/') => end_of_line(&text, i),
            ('/', '*') => end_of_block_comment(&text, i),
            ('r', '"' | '#') if begins_word => end_of_raw_string(&text, i + 1),
            ('b', 'r') if begins_word => end_of_raw_string(&text, i + 2),
            ('"', _) => Some(end_of_quoted(&text, i)),
            ('\'', '\\') => Some(end_of_quoted(&text, i)),
            ('\'', _) if text.get(i + 2) == Some(&'\'') => Some(i + 3),
            _ => None,
        };
        let Some(end) = end else {
            code.push(text[i]);
            i += 1;
            continue;
        };
        code.extend((text[i..end].iter()).map(|c| if *c == '\n' { '\n' } else { ' ' }));
        i = end;
    }
    code
}

fn end_of_line(text: &[char], begin: usize) -> Option<usize> {
    let length = text[begin..].iter().position(|c| *c == '\n');
    Some(length.map_or(text.len(), |length| begin + length))
}

fn end_of_block_comment(text: &[char], begin: usize) -> Option<usize> {
    let (mut depth, mut i) = (0, begin);
    while i + 1 < text.len() {
        match (text[i], text[i + 1]) {
            ('/', '*') => depth += 1,
            ('*', '/') => depth -= 1,
            _ => {
                i += 1;
                continue;
            }
        }
        i += 2;
        if depth == 0 {
            return Some(i);
        }
    }
    Some(text.len())
}

/// Returns the end of a raw string whose `#` or quotation mark is at `begin`; `None` for a raw identifier.
fn end_of_raw_string(text: &[char], begin: usize) -> Option<usize> {
    let hashes = text[begin..].iter().take_while(|c| **c == '#').count();
    if text.get(begin + hashes) != Some(&'"') {
        return None;
    }
    let mut i = begin + hashes + 1;
    while i < text.len() {
        let after = &text[i + 1..text.len().min(i + 1 + hashes)];
        if text[i] == '"' && after.len() == hashes && after.iter().all(|c| *c == '#') {
            return Some(i + 1 + hashes);
        }
        i += 1;
    }
    Some(text.len())
}

/// Returns the end of a text or a character that begins at `begin` with its quotation mark.
fn end_of_quoted(text: &[char], begin: usize) -> usize {
    let mut i = begin + 1;
    while i < text.len() && text[i] != text[begin] {
        i += if text[i] == '\\' { 2 } else { 1 };
    }
    text.len().min(i + 1)
}

/// Makes the items for tests blank. Returns the names of the modules among them that are files.
fn remove_test_items(code: &mut String) -> Vec<String> {
    let mut test_modules = Vec::new();
    let mut from = 0;
    while let Some(begin) = ["#[cfg(test)]", "#[cfg(all(test"]
        .iter()
        .filter_map(|attribute| Some(from + code[from..].find(attribute)?))
        .min()
    {
        let end = end_of_item(code, begin);
        let item = &code[begin..end];
        let name = item.split("mod ").nth(1).and_then(|rest| {
            let name = rest.trim_end().strip_suffix(';')?;
            name.chars()
                .all(is_name_character)
                .then(|| name.to_string())
        });
        test_modules.extend(name);
        let blank: String = (item.chars())
            .map(|c| if c == '\n' { '\n' } else { ' ' })
            .collect();
        code.replace_range(begin..end, &blank);
        from = begin + blank.len();
    }
    test_modules
}

/// Returns the end of an item that begins with an attribute: after its semicolon or its closing brace.
fn end_of_item(code: &str, begin: usize) -> usize {
    let mut depth = 0;
    for (i, c) in code[begin..].char_indices() {
        match c {
            '(' | '[' | '{' => depth += 1,
            ')' | ']' | '}' => {
                depth -= 1;
                if depth < 0 {
                    return begin + i;
                }
                if depth == 0 && c == '}' {
                    return begin + i + 1;
                }
            }
            ';' if depth == 0 => return begin + i + 1,
            _ => {}
        }
    }
    code.len()
}

/// Returns the names that follow `crate::`, with their lines, and whether each is called as a function.
fn crate_names(code: &str) -> Vec<(usize, String, bool)> {
    let mut names = Vec::new();
    for (at, prefix) in code.match_indices("crate::") {
        if code[..at]
            .chars()
            .next_back()
            .is_some_and(is_name_character)
        {
            continue;
        }
        let begin = at + prefix.len();
        let mut add = |begin: usize, text: &str| {
            let length = text.find(|c| !is_name_character(c)).unwrap_or(text.len());
            let is_call = text[length..].starts_with('(');
            let line = code[..begin].matches('\n').count() + 1;
            names.push((line, text[..length].to_string(), is_call));
        };
        let rest = &code[begin..];
        if !rest.starts_with('{') {
            add(begin, rest);
            continue;
        }
        // A group: a name begins after each comma outside inner braces.
        let (mut depth, mut is_new) = (0, false);
        for (i, c) in rest.char_indices() {
            match c {
                '{' => depth += 1,
                '}' => depth -= 1,
                _ if is_new && is_name_character(c) => {
                    add(begin + i, &rest[i..]);
                    is_new = false;
                }
                _ => {}
            }
            is_new |= depth == 1 && (c == '{' || c == ',');
            if depth == 0 {
                break;
            }
        }
    }
    names
}

/// Returns the names that the root of the library re-exports, each with its module.
fn reexports(root: &str) -> BTreeMap<String, String> {
    let mut modules = BTreeMap::new();
    for (at, _) in root.match_indices("pub use ") {
        let path = root[at + 8..].split(';').next().unwrap_or_default();
        let module = path.split("::").next().unwrap_or_default();
        let names = match path.split_once('{') {
            Some((_, names)) => names.trim_end().trim_end_matches('}'),
            None => path.rsplit("::").next().unwrap_or_default(),
        };
        for name in names.split(',') {
            modules.insert(name.trim().to_string(), module.to_string());
        }
    }
    modules
}

/// Adds the paths of all sources in a folder.
fn add_sources(folder: &Path, sources: &mut Vec<PathBuf>) {
    let mut paths: Vec<PathBuf> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    paths.sort();
    for path in paths {
        if path.is_dir() {
            add_sources(&path, sources);
        } else if path.extension().is_some_and(|ending| ending == "rs") {
            sources.push(path);
        }
    }
}

/// Returns the module at the top to which a source belongs.
fn module_of(source: &Path, folder: &Path) -> String {
    let path = source.strip_prefix(folder).unwrap();
    let first = path.components().next().unwrap().as_os_str();
    first.to_str().unwrap().trim_end_matches(".rs").to_string()
}

/// Returns `true` for a source that only tests use, by its name.
fn is_named_test(source: &Path) -> bool {
    let mut parts = source.components().map(|part| part.as_os_str().to_str());
    parts.any(|part| part.is_some_and(|name| name == "tests" || name.ends_with("tests.rs")))
}

/// Returns the first words of the lines of the first block of code after `heading` that are names of modules.
fn modules_in_map(page: &str, heading: &str) -> Vec<String> {
    let after = page.split_once(heading).unwrap().1;
    let block = after.split("```").nth(1).unwrap();
    (block.lines())
        .filter_map(|line| line.split_whitespace().next())
        .filter(|word| all_modules().any(|module| module == *word))
        .map(String::from)
        .collect()
}

/// Returns the code of each source in a folder, without comments and tests.
fn code_of_sources(folder: &Path) -> BTreeMap<PathBuf, String> {
    let mut sources = Vec::new();
    add_sources(folder, &mut sources);
    sources.retain(|source| !is_named_test(source));
    let mut code_of = BTreeMap::new();
    let mut test_files: Vec<PathBuf> = Vec::new();
    for source in sources {
        let mut code = without_comments(&fs::read_to_string(&source).unwrap());
        let is_folder = source.ends_with("mod.rs") || source.ends_with("lib.rs");
        let children = if is_folder {
            source.parent().unwrap().to_path_buf()
        } else {
            source.with_extension("")
        };
        for name in remove_test_items(&mut code) {
            test_files.extend([children.join(format!("{name}.rs")), children.join(&name)]);
        }
        code_of.insert(source, code);
    }
    code_of.retain(|source, _| !test_files.iter().any(|path| source.starts_with(path)));
    code_of
}

#[test]
fn modules_name_only_those_below_them() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = root.join("src");
    let code_of = code_of_sources(&folder);
    let mut modules = reexports(&code_of[&folder.join("lib.rs")]);
    for (source, code) in &code_of {
        for exported in code.split("#[macro_export]").skip(1) {
            let name = exported.split("macro_rules! ").nth(1).unwrap();
            let name = name.split_whitespace().next().unwrap();
            modules.insert(name.to_string(), module_of(source, &folder));
        }
    }
    let mut problems = Vec::new();
    for (source, code) in &code_of {
        let user = module_of(source, &folder);
        if user == "lib" || user == "main" {
            continue;
        }
        let shown = source.strip_prefix(root).unwrap().display();
        if !all_modules().any(|module| module == user) {
            problems.push(format!(
                "{shown}: the table of tests/layers.rs lacks {user}"
            ));
            continue;
        }
        for (line, name, is_call) in crate_names(code) {
            let is_module = all_modules().any(|module| module == name);
            let used = match modules.get(&name) {
                Some(module) if is_call || !is_module => module,
                _ => &name,
            };
            if !may_name(&user, used) {
                problems.push(format!(
                    "{shown}:{line}: {user} may not name {used} (crate::{name})"
                ));
            }
        }
    }
    assert!(
        problems.is_empty(),
        "{} names are against the order of the layers:\n{}",
        problems.len(),
        problems.join("\n")
    );
    for module in all_modules() {
        let exists = |user: &PathBuf| module_of(user, &folder) == module;
        assert!(code_of.keys().any(exists), "there is no module {module}");
    }
}

#[test]
fn few_files_know_the_ranks() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files: Vec<String> = Vec::new();
    for (source, code) in code_of_sources(&folder) {
        let names_comm = crate_names(&code).iter().any(|(_, name, _)| name == "comm");
        if names_comm && !MODULES_WITH_RANKS.contains(&module_of(&source, &folder).as_str()) {
            let path = source.strip_prefix(&folder).unwrap();
            files.push(path.to_str().unwrap().replace('\\', "/"));
        }
    }
    assert_eq!(files, FILES_WITH_RANKS);
}

#[test]
fn the_maps_have_the_modules_in_their_order() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let expected: Vec<&str> = all_modules().collect();
    let page = fs::read_to_string(root.join("ARCHITECTURE.md")).unwrap();
    assert_eq!(modules_in_map(&page, "\n## Map\n"), expected);
    let front_page = fs::read_to_string(root.join("src/lib.rs")).unwrap();
    let front_page = front_page.replace("\n//!", "\n");
    assert_eq!(modules_in_map(&front_page, ""), expected);
}

#[test]
fn names_are_found_outside_comments_and_tests() {
    let source = r##"
        //! crate::a
        use crate::{
            b::{c, d},
            e,
        };
        /* crate::f /* crate::g */ */
        const TEXT: [&str; 3] = ["crate::h", r#"" crate::i"#, "\" crate::j"];
        fn k<'a>(x: &'a str) { crate::l(x, '"', '\''); mycrate::m() }
        #[cfg(test)]
        mod n;
        #[cfg(test)]
        use crate::{o, p};
        #[cfg(all(test, unix))]
        mod q { use crate::r; }
        use crate::s::t;
    "##;
    let mut code = without_comments(source);
    assert_eq!(remove_test_items(&mut code), ["n"]);
    let names = crate_names(&code);
    let names: Vec<_> = names.iter().map(|(l, n, c)| (*l, n.as_str(), *c)).collect();
    assert_eq!(
        names,
        [
            (4, "b", false),
            (5, "e", false),
            (9, "l", true),
            (16, "s", false)
        ]
    );
    assert!(may_name("job", "image") && !may_name("image", "job"));
    assert!(!may_name("store", "job") && !may_name("job", "store") && may_name("cli", "job"));
}
