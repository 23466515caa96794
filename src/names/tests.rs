//! Tests of names that are made legal and distinct.

use super::*;
use crate::export::formats;

fn given(names: &[&str]) -> Vec<WantedName> {
    let wanted = names.iter().map(|name| WantedName {
        name: (*name).into(),
        source: NameSource::Given,
    });
    wanted.collect()
}

/// Returns sets of names that some format cannot hold as they are.
fn difficult_names() -> Vec<Vec<String>> {
    let texts = |names: &[&str]| names.iter().map(|name| name.to_string()).collect();
    let long = |ending: &str| format!("{}{ending}", "a".repeat(100 - ending.len()));
    let same_start = |end: &str| format!("{}{end}", "lobe_".repeat(8));
    vec![
        texts(&["Bone", "bone", "BONE", "bone_2", "BONE_2"]),
        texts(&["rib 1.5", "rib 1-5", "rib_1_5", "rib,1;5", "rib/1\\5"]),
        texts(&["Unit-1", "Unit_1", "1", "region1", "r1", "Unit 1"]),
        texts(&["左肺", "右肺", "Größe", "Grösse", "GRÖSSE"]),
        texts(&["", " ", "_", "\t", "a\nb", "\"quoted\"", "'x'"]),
        texts(&[
            "eall", "EALL", "nall", "all", "NALL", "ALL", "FIELD", "field",
        ]),
        texts(&[
            "xmin",
            "XMIN",
            "boundary",
            "scraps",
            "fault1",
            "interface_1_2",
        ]),
        texts(&[
            "end",
            "Zone",
            "Cells",
            "T",
            "attribute",
            "SEED",
            "internalMesh",
        ]),
        texts(&["..", ".", "-1", "1e5", "#x", "*", "x_2", "x", "X"]),
        vec![
            long("x"),
            long("y"),
            long("xx"),
            same_start("left"),
            same_start("right"),
        ],
        (0..300).map(|i| format!("fracture{i}")).collect(),
    ]
}

/// Returns the rules of all formats for names of all kinds, with the name of the format.
fn all_rules() -> Vec<(String, NameRules)> {
    let mut all = vec![
        ("text".to_string(), NameRules::TEXT),
        ("unspaced".to_string(), NameRules::UNSPACED),
        ("file".to_string(), NameRules::FILE),
    ];
    for format in formats() {
        let rules = format.names.all_rules().into_iter();
        all.extend(rules.map(|(kind, rules)| (format!("{} {kind}", format.name), rules)));
    }
    assert!(all.len() > 30);
    all
}

#[test]
fn names_are_legal_distinct_and_independent_of_order() {
    for (place, rules) in all_rules() {
        for set in difficult_names() {
            let wanted: Vec<WantedName> = (set.iter().enumerate())
                .map(|(at, name)| WantedName::given_or(Some(name), || format!("region{at}")))
                .collect();
            let names = assign(&rules, &wanted);
            let mut folded: Vec<String> = names.iter().map(|name| rules.folded(name)).collect();
            folded.extend(rules.reserved.iter().map(|name| rules.folded(name)));
            let count = folded.len();
            folded.sort();
            folded.dedup();
            assert_eq!(folded.len(), count, "{place}: {set:?} {names:?}");
            for name in &names {
                assert!(rules.is_legal(name), "{place}: {name}");
                assert!(
                    !name.is_empty() && name.len() <= rules.max_bytes,
                    "{place}: {name}"
                );
            }
            let reversed: Vec<WantedName> = wanted.iter().rev().cloned().collect();
            let mut again = assign(&rules, &reversed);
            again.reverse();
            assert_eq!(again, names, "{place}: {set:?}");
            // A changed name is never one that another object has legally.
            for (at, name) in names.iter().enumerate() {
                let is_taken = |(other, wanted): (usize, &WantedName)| {
                    other != at && *name == wanted.name && names[other] != *name
                };
                let thief = wanted.iter().enumerate().any(is_taken);
                let is_own = *name == wanted[at].name;
                let loses_to_case = rules.case != LetterCase::Sensitive;
                assert!(
                    !thief || is_own || loses_to_case,
                    "{place}: {name} of {set:?}"
                );
            }
        }
    }
}

#[test]
fn legal_and_distinct_names_stay_as_they_are() {
    let wanted = given(&["Bone", "bone", "rib 1.5", "Größe"]);
    let names = assign(&NameRules::TEXT, &wanted);
    assert_eq!(names, ["Bone", "bone", "rib 1.5", "Größe"]);
    let upper = NameRules {
        case: LetterCase::Upper,
        reserved: &["EALL"],
        ..NameRules::HYPHENATED
    };
    let names = assign(
        &upper,
        &given(&["bone", "Bone", "eall", "rib 1.5", "rib_1_5", "2"]),
    );
    assert_eq!(
        names,
        ["BONE_2", "BONE", "EALL_2", "RIB_1_5_2", "RIB_1_5", "N2"]
    );
}

#[test]
fn default_names_give_way_to_given_ones() {
    let wanted = [
        WantedName::given_or(None, || "region2".into()),
        WantedName::given_or(Some("region2"), String::new),
        WantedName::program("xmin"),
        WantedName::given_or(Some("xmin"), String::new),
    ];
    let names = assign(&NameRules::TEXT, &wanted);
    assert_eq!(names, ["region2_2", "region2", "xmin", "xmin_2"]);
}

#[test]
fn equal_and_long_names_get_numbers_within_the_length() {
    let short = NameRules {
        max_bytes: 8,
        distinct_bytes: 8,
        ..NameRules::IDENTIFIER
    };
    let wanted = given(&["fracture_a", "fracture_b", "fracture", "fracture"]);
    let names = assign(&short, &wanted);
    assert_eq!(names, ["fractu_3", "fractu_4", "fracture", "fractu_2"]);
    let mut list = vec!["a".to_string()];
    append_distinct(&mut list, ["a", "b", "a"].map(String::from));
    assert_eq!(list, ["a", "a_2", "b", "a_3"]);
}

#[test]
fn the_table_lists_changes_only_if_there_are_any() {
    let entry = |name: &str, written: &str, is_numbered| NameEntry {
        kind: "region",
        number: 3,
        name: name.into(),
        written: written.into(),
        is_numbered,
        is_given: true,
    };
    let table = |entries: &[NameEntry]| NameTable {
        entries: entries.to_vec(),
    };
    assert_eq!(table(&[entry("bone", "BONE", false)]).comments("** "), "");
    let changed = table(&[entry("a,\"b\"", "a__b_", false)]);
    assert_eq!(
        changed.csv(),
        "kind,number,name,written\nregion,3,\"a,\"\"b\"\"\",a__b_\n"
    );
    assert!(
        changed
            .comments("-- ")
            .ends_with("-- region 3 'a,\"b\"' is a__b_\n")
    );
    assert!(
        changed
            .note("x.csv")
            .is_some_and(|note| note.starts_with("1 of 1 names"))
    );
    let numbered = table(&[entry("bone", "3", true)]);
    assert!(numbered.is_needed() && numbered.note("x").is_none());
}
