use super::*;

const TERMS: &[Term] = &[
    Term::new("x", &["easting", "utmx"]),
    Term::new("y", &["northing", "utmy"]),
    Term::new("z", &["depth", "elevation"]),
    Term::new("name", &["fault"]),
];

const POINTS: [[f64; 3]; 3] = [
    [450_334.5, 6_780_000.75, -1215.125],
    [450_289.25, 6_780_010.5, -1344.5],
    [450_244.0, 6_780_020.25, -0.125],
];

fn parse(text: &str) -> Result<Table> {
    Table::parse(Path::new("t.csv"), text.to_string(), TERMS)
}

fn message(text: &str) -> String {
    let table = parse(text);
    let numbers = table.and_then(|table| {
        for row in table.rows() {
            (0..table.columns().len()).try_for_each(|k| row.number(k).map(|_| ()))?;
        }
        Ok(())
    });
    numbers.unwrap_err().to_string()
}

/// Returns the points of a table by the names of its columns.
fn points(table: &Table) -> Vec<[f64; 3]> {
    let columns = ["x", "y", "z"].map(|name| table.column(name).unwrap().unwrap());
    let point = |row: TableRow<'_>| columns.map(|k| row.number(k).unwrap().unwrap());
    table.rows().map(point).collect()
}

/// Ways in which the columns are named.
#[derive(Debug, Clone, Copy)]
enum Style {
    Plain,
    Quoted,
    Aliases,
    Bracketed,
    UnitLine,
    Comment,
    Block,
}

/// A table as some program writes it.
#[derive(Debug, Clone, Copy)]
struct Writer {
    separator: &'static str,
    decimal_comma: bool,
    comment: &'static str,
    end: &'static str,
    order: [usize; 3],
    style: Style,
    footer: &'static str,
}

impl Writer {
    fn text(&self) -> String {
        let join = |fields: [String; 3]| self.order.map(|k| fields[k].clone()).join(self.separator);
        let names = |names: [&str; 3]| join(names.map(String::from));
        let mut lines = vec![format!("{} made for a test, 17.5 of it", self.comment)];
        match self.style {
            Style::Plain => lines.push(names(["X", "y", "Z"])),
            Style::Quoted => lines.push(names(["\"X\"", "\"Y\"", "\"Z\""])),
            Style::Aliases => lines.push(names(["UTM_X", "Northing", "DEPTH"])),
            Style::Bracketed => lines.push(names(["X(m)", "Y[m]", "Depth(ft)"])),
            Style::UnitLine => {
                lines.push(names(["x", "y", "z"]));
                lines.push(names(["m", "(m)", "ft"]));
            }
            Style::Comment => lines.push(format!("{} {}", self.comment, names(["x", "y", "z"]))),
            Style::Block => {
                lines.push("VERSION 1".into());
                lines.push("BEGIN HEADER".into());
                lines.extend(self.order.map(|k| ["X", "FLOAT,Y", "Z"][k].to_string()));
                lines.push("END HEADER".into());
            }
        }
        for (k, point) in POINTS.iter().enumerate() {
            let number = |value: &f64| {
                let text = value.to_string();
                if self.decimal_comma {
                    text.replace('.', ",")
                } else {
                    text
                }
            };
            lines.push(join(std::array::from_fn(|k| number(&point[k]))));
            if k == 0 {
                lines.push(String::new());
                lines.push(format!("{} between rows", self.comment));
            }
        }
        lines.push(self.footer.into());
        lines.join(self.end)
    }
}

#[test]
fn tables_of_all_writers_are_read() {
    let orders = [
        [0, 1, 2],
        [0, 2, 1],
        [1, 0, 2],
        [1, 2, 0],
        [2, 0, 1],
        [2, 1, 0],
    ];
    let styles = [
        Style::Plain,
        Style::Quoted,
        Style::Aliases,
        Style::Bracketed,
        Style::UnitLine,
        Style::Comment,
        Style::Block,
    ];
    let marks = [
        (",", false),
        (";", false),
        (";", true),
        ("\t", false),
        ("\t", true),
        (" ", false),
        ("   ", true),
        (", ", false),
    ];
    let comments = ["#", "!", "//", "--", "@", "%"];
    let ends = ["\n", "\r\n", "\r"];
    let footers = ["", "EOF", "END", "-----", "Total: 3 points"];
    let mut count = 0;
    for (separator, decimal_comma) in marks {
        for comment in comments {
            for style in styles {
                for order in orders {
                    // The other two dimensions take turns.
                    let (end, footer) = (ends[count % 3], footers[count % 5]);
                    let writer = Writer {
                        separator,
                        decimal_comma,
                        comment,
                        end,
                        order,
                        style,
                        footer,
                    };
                    let text = writer.text();
                    let table = parse(&text).unwrap_or_else(|e| panic!("{e}\n{writer:?}\n{text}"));
                    assert_eq!(points(&table), POINTS, "{writer:?}\n{text}");
                    if matches!(style, Style::Bracketed | Style::UnitLine) {
                        let unit = |name: &str| {
                            let column = table.column(name).unwrap().unwrap();
                            table.columns()[column].unit.clone()
                        };
                        assert_eq!([unit("x"), unit("z")].map(Option::unwrap), ["m", "ft"]);
                    }
                    count += 1;
                }
            }
        }
    }
    assert_eq!(count, 8 * 6 * 7 * 6);
}

#[test]
fn tables_without_names_have_their_rows_after_words() {
    let table = parse("Points of today\nVERSION 1\n1 2 3\n4 5 6\n").unwrap();
    assert!(!table.has_names());
    let rows: Vec<_> = table
        .rows()
        .map(|row| (row.line, row.numbers().unwrap()))
        .collect();
    assert_eq!(rows, [(3, vec![1.0, 2.0, 3.0]), (4, vec![4.0, 5.0, 6.0])]);
    assert_eq!(table.remarks().len(), 2);
    let table = parse("Fault: name\nDate: 2020\nX Y Z\n1 2 3\n4 5 6\n").unwrap();
    assert_eq!(points(&table), [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]);
}

#[test]
fn texts_of_other_encodings_are_read() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("t.csv");
    let text = "x,y,z,name\n1,2,3,Gr\u{fc}n\n";
    let wide = |units: Vec<[u8; 2]>, mark: [u8; 2]| [vec![mark], units].concat().concat();
    let files: [Vec<u8>; 5] = [
        text.into(),
        format!("\u{feff}{text}").into(),
        text.chars().map(|c| c as u8).collect(),
        wide(
            text.encode_utf16().map(u16::to_le_bytes).collect(),
            [0xff, 0xfe],
        ),
        wide(
            text.encode_utf16().map(u16::to_be_bytes).collect(),
            [0xfe, 0xff],
        ),
    ];
    for bytes in files {
        std::fs::write(&path, bytes).unwrap();
        let table = Table::read(&path, TERMS).unwrap();
        assert_eq!(points(&table), [[1.0, 2.0, 3.0]]);
        let row = table.rows().next().unwrap();
        assert_eq!(
            row.text(table.column("name").unwrap().unwrap()),
            Some("Gr\u{fc}n")
        );
    }
}

#[test]
fn names_with_blanks_are_one_field_between_blanks() {
    let table = parse("Fault X Y Z\nMain fault 1 2 -3\n\"Side fault\" 4 5 6\nF1 7 8 9\n").unwrap();
    let names: Vec<String> = table
        .rows()
        .map(|row| row.text(0).unwrap().to_string())
        .collect();
    assert_eq!(names, ["Main fault", "Side fault", "F1"]);
    assert_eq!(points(&table)[0], [1.0, 2.0, -3.0]);
}

#[test]
fn numbered_comments_name_the_columns() {
    for text in [
        "# 1: X\n# 2: Y\n# 3: Z (ms)\n# - - - -\n1 2 3\n",
        "# Type: scattered data\n# Field: 1 x\n# Field: 2 y\n# Field: 3 z ms\n1 2 3\n",
        "! Columns: X Y Z(ms)\n1 2 3\n",
    ] {
        let table = parse(text).unwrap();
        assert_eq!(points(&table), [[1.0, 2.0, 3.0]], "{text}");
        assert_eq!(table.columns()[2].unit.as_deref(), Some("ms"), "{text}");
    }
}

#[test]
fn las_files_have_curves_units_and_the_wells_header() {
    let text = "~Version\nVERS. 2.0 : CWLS\nWRAP. NO :\n~Well\nNULL. -999.25 :\nWELL. A-1 : name\nXCOORD.m 450000.5 :\n\
                ~Curve\nX.m : east\nY.m : north\nDEPTH.ft : depth\n~A X Y DEPTH\n1 2 3\n4 5 -999.25\n";
    let table = parse(text).unwrap();
    assert_eq!(points(&table), [[1.0, 2.0, 3.0], [4.0, 5.0, -999.25]]);
    assert_eq!(table.nulls(), [-999.25]);
    assert_eq!(table.columns()[2].unit.as_deref(), Some("ft"));
    assert_eq!(
        table.remark_value(&["xcoord"]),
        Some((450_000.5, Some("m".into())))
    );
    assert!(table.remark_text(&["well"]).unwrap().starts_with("A-1"));
    assert!(message(&text.replace("WRAP. NO", "WRAP. YES")).contains("wrapped lines"));
}

#[test]
fn segments_and_missing_values_are_told_apart() {
    let table = parse("x;y;z\n> 1\n1;2;3\n4;;6\n> 2\n7;nan;9\n").unwrap();
    let rows: Vec<_> = table
        .rows()
        .map(|row| (row.segment, row.number(1).unwrap()))
        .collect();
    assert_eq!(rows, [(1, Some(2.0)), (1, None), (2, None)]);
}

#[test]
fn what_is_not_understood_is_an_error_with_its_line() {
    for (text, expected) in [
        (
            "x,y,z\n1,2,3\n1,two,3\n",
            "t.csv:3: 'two' in column y is not a number",
        ),
        (
            "x;y;z\n450,334.5;2;3\n",
            "t.csv:2: '450,334.5' in column x is not a number; write decimal points and no",
        ),
        ("x;y;z\n6.780.000,5;2;3\n", "no separators of thousands"),
        ("x;y;z\n450,334;1;2\n", "t.csv:2: '450,334' in column x"),
        ("x;y;z\n6 780 000;1;2\n", "no separators of thousands"),
        (
            "x,y,z\n450,334.5,6,780,000.0,-1\n",
            "t.csv:2: has 6 fields, but the table 3 columns",
        ),
        ("x y z\n1 2\n3 4 5\n", "t.csv:2: has 2 fields"),
        (
            "x;y;z\n1,5;2.5;3\n",
            "write decimal points in all numbers, or decimal commas in all",
        ),
    ] {
        let error = message(text);
        assert!(error.contains(expected), "{text}: {error}");
    }
    let table = parse("x,easting,y,z\n1,2,3,4\n").unwrap();
    let error = table.column("x").unwrap_err().to_string();
    assert!(
        error.starts_with("t.csv:1: the columns 'x' and 'easting' both mean x"),
        "{error}"
    );
    let table = parse("x,easting,y,z\n1,1,3,4\n").unwrap();
    assert_eq!(table.column("x").unwrap(), Some(0));
    let table = parse("right,high,z\n1,2,3\n").unwrap();
    let error = table.required(&TERMS[0]).unwrap_err().to_string();
    assert!(
        error.contains(
            "has no column x: its columns are right, high, z; name a column one of x, easting"
        ),
        "{error}"
    );
}

#[test]
fn grids_of_other_programs_are_refused_with_their_format() {
    for (text, format) in [
        (
            "ncols 3\nnrows 2\nxllcorner -5.0\nyllcorner -5.0\ncellsize 10.0\nNODATA_value -9999\n69.0 67.9 66.9\n68.0 66.7 65.5\n",
            "t.csv: is an ESRI ASCII grid",
        ),
        (
            "NCOLS 3\r\nNROWS 2\r\nXLLCENTER 0\r\nYLLCENTER 0\r\nCELLSIZE 1\r\n1 2 3\r\n4 5 6\r\n",
            "t.csv: is an ESRI ASCII grid",
        ),
        (
            "DSAA\n3 2\n0 20\n0 10\n-6 -1\n-1 -2 -3\n-4 -5 -6\n",
            "t.csv: is a Surfer grid",
        ),
    ] {
        let error = message(text);
        assert!(error.starts_with(format), "{error}");
        assert!(
            error.contains("of heights, not a table; give it as a surface"),
            "{error}"
        );
    }
    assert!(parse("x,y,z,ncols\n1,2,3,4\n").is_ok());
}

#[test]
fn values_are_read_by_surface_and_by_region() {
    const KIND: ValueTable = ValueTable {
        terms: &[
            Term::new("surface", &["fault"]),
            Term::new("factor", &["mult"]),
        ],
        meaning: "a surface and its factor",
        remedy: "write surface,factor",
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("v.csv");
    let read = |text: &str| {
        std::fs::write(&path, text).unwrap();
        let take = |words: &[&str]| match words {
            [name, factor] => Some((name.to_string(), factor.parse::<f64>().ok()?)),
            _ => None,
        };
        text_rows(&path, &KIND, take).map_err(|e| e.to_string())
    };
    for text in [
        "Main fault,0.5\n",
        "surface,factor\nMain fault,0.5\n",
        "MULT;Fault\n0,5;Main fault\n",
        "comment\tmult\tfault\nx\t0.5\tMain fault\n",
    ] {
        assert_eq!(
            read(text).unwrap()[0].1,
            ("Main fault".to_string(), 0.5),
            "{text}"
        );
    }
    assert!(
        read("a,b,c\nd,e,1\n")
            .unwrap_err()
            .contains("v.csv:1: has no column surface")
    );
    assert!(
        read("Main fault,half\n")
            .unwrap_err()
            .contains("v.csv:1: 'Main fault,half' is not a surface and its factor")
    );

    let regions = |text: &str| {
        std::fs::write(&path, text).unwrap();
        values_by_region(&path, |values| Some(values.to_vec()), "write region,value")
            .map_err(|e| e.to_string())
    };
    for text in [
        "1,2.5,3\n-4,5,6\n",
        "Region;KX;KY\n1;2,5;3\n-4;5;6\n",
        "KY,Label,KX\n3,1,2.5\n6,-4,5\n# end\n",
    ] {
        assert_eq!(
            regions(text).unwrap(),
            [(1, vec![2.5, 3.0]), (-4, vec![5.0, 6.0])],
            "{text}"
        );
    }
    assert!(
        regions("1,2\n1,3\n")
            .unwrap_err()
            .contains("v.csv:2: region 1 is given twice")
    );
    assert!(
        regions("1.5,2\n")
            .unwrap_err()
            .contains("v.csv:1: '1.5,2' is not a region and its value")
    );
}
