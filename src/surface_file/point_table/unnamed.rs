//! Surfaces in tables without names of columns.

use std::collections::{BTreeMap, BTreeSet};

use super::{Group, TableReadings, line_steps};
use crate::files::table::Table;
use crate::geometry::statistics::upper_median;
use crate::image::stated::StatedCoordinates;
use crate::surface_file::interpretation::{PickedShape, PickedSurface};
use crate::surface_file::place_columns::{PlaceReading, number_columns};
use crate::{Result, names};

/// Smallest change of z with the distance in the plane along sticks whose points lie at even distances.
/// In a horizon, even distances are those of its lines.
const MIN_STICK_SLOPE: f64 = 0.5;

/// Returns the surfaces of a table without names of columns, with all readings of them: one for each
/// name, if a column has names.
pub(super) fn guessed_surfaces(table: &Table, stem: &str) -> Result<Vec<PickedSurface>> {
    let width = table.columns().len();
    let is_number = number_columns(table);
    let columns: Vec<usize> = (0..width).filter(|&k| is_number[k]).collect();
    if table.is_empty() {
        return Ok(Vec::new());
    }
    check_rows(table, &columns)?;
    let (mut groups, has_lines) = read_groups(table, &columns, &is_number, stem);
    let values: Vec<f64> = groups
        .iter()
        .flat_map(|group| &group.values)
        .copied()
        .collect();
    let readings = guesses(&columns, &values, width);
    let has_sticks = !has_lines && take_sticks(&mut groups, width, &columns);
    let is_named = groups.len() > 1;
    let surface = |group: Group| {
        let name = if is_named {
            names::from_file(&group.name)
        } else {
            group.name.clone()
        };
        let shape = if has_lines || has_sticks {
            PickedShape::Sticks(group.sticks(width, &readings[0]))
        } else {
            let table = TableReadings {
                values: group.values,
                width,
                readings: readings.clone(),
            };
            match readings.len() {
                1 => PickedShape::Points(table.points(0)),
                _ => PickedShape::Readings(table),
            }
        };
        let begins_with = |kind: &str| is_named && name.to_lowercase().starts_with(kind);
        let is_horizon = if has_lines || has_sticks || begins_with("fault") {
            Some(false)
        } else {
            begins_with("horizon").then_some(true)
        };
        PickedSurface {
            name,
            is_horizon,
            shape,
            coordinates: StatedCoordinates::default(),
            notes: Vec::new(),
        }
    };
    Ok(groups.into_iter().map(surface).collect())
}

/// Refuses rows without three numbers.
fn check_rows(table: &Table, columns: &[usize]) -> Result<()> {
    let third = columns.get(2);
    match table
        .rows()
        .find(|row| third.is_none_or(|&third| row.len() <= third))
    {
        Some(row) => {
            let count = columns.iter().filter(|&&k| k < row.len()).count();
            let remedy = "give x, y and z in each line, or a file of surfaces (.ts, .vtp, .obj)";
            Err(row.error(format!("has {count} numbers"), remedy))
        }
        None => Ok(()),
    }
}

/// Returns the rows of each surface, and `true` if marks or rows of 999 separate lines.
fn read_groups(
    table: &Table,
    columns: &[usize],
    is_number: &[bool],
    stem: &str,
) -> (Vec<Group>, bool) {
    let names = name_column(table, is_number);
    let mut groups: Vec<Group> = Vec::new();
    let mut indices: BTreeMap<String, usize> = BTreeMap::new();
    let mut segments: BTreeSet<usize> = BTreeSet::new();
    let mut segment = 0;
    for row in table.rows() {
        let numbers: Vec<f64> = (0..is_number.len())
            .map(|k| row.number(k).ok().flatten().unwrap_or(f64::NAN))
            .collect();
        // IRAP separates lines by rows of 999.
        if columns[..3].iter().all(|&k| numbers[k] == 999.0) {
            segment += 1;
            continue;
        }
        let name = names.and_then(|column| row.text(column)).unwrap_or(stem);
        let index = *indices.entry(name.to_string()).or_insert_with(|| {
            groups.push(Group {
                name: name.to_string(),
                values: Vec::new(),
                rows: Vec::new(),
                missing: 0,
            });
            groups.len() - 1
        });
        groups[index].values.extend(numbers);
        let number = segment + row.segment;
        groups[index].rows.push((row.line, number.to_string()));
        segments.insert(number);
    }
    (groups, segments.len() > 1)
}

/// Returns the only column of texts that has several names, each on average in three rows at least.
fn name_column(table: &Table, is_number: &[bool]) -> Option<usize> {
    let count = table.rows().count();
    let mut texts: Vec<BTreeSet<String>> = vec![BTreeSet::new(); is_number.len()];
    for row in table.rows() {
        for (k, texts) in texts.iter_mut().enumerate() {
            if is_number[k] || 3 * texts.len() > count {
                continue;
            }
            if let Some(text) = row.text(k)
                && !texts.contains(text)
            {
                texts.insert(text.to_string());
            }
        }
    }
    let has_names = |&k: &usize| texts[k].len() > 1 && 3 * texts[k].len() <= count;
    let mut columns = (0..texts.len()).filter(has_names);
    columns.next().filter(|_| columns.next().is_none())
}

/// Takes the sticks of rows `x y z stick node`, and returns `true` if all rows are such.
fn take_sticks(groups: &mut [Group], width: usize, columns: &[usize]) -> bool {
    let &[x, y, z, stick, node] = columns else {
        return false;
    };
    let columns = [x, y, z, stick, node];
    let are_sticks = |group: &Group| has_numbered_sticks(&group.values, width, columns);
    if !groups.iter().all(are_sticks) {
        return false;
    }
    for group in groups {
        let rows = group.values.chunks_exact(width);
        for ((_, name), row) in group.rows.iter_mut().zip(rows) {
            *name = row[stick].to_string();
        }
    }
    true
}

/// Returns `true` if the rows of a fault have numbers of sticks that grow, and numbers of nodes that
/// count the points of each stick from 0 or 1. `columns` are those of x, y, z, stick and node.
fn has_numbered_sticks(values: &[f64], width: usize, columns: [usize; 5]) -> bool {
    let rows: Vec<[f64; 5]> = values
        .chunks_exact(width)
        .map(|row| columns.map(|k| row[k]))
        .collect();
    let sticks: Vec<&[[f64; 5]]> = rows.chunk_by(|a, b| a[3] == b[3]).collect();
    let counts = |stick: &&[[f64; 5]]| {
        let first = stick[0][4];
        let mut nodes = (0i32..).zip(stick.iter());
        (first == 0.0 || first == 1.0) && nodes.all(|(k, row)| row[4] == first + f64::from(k))
    };
    let are_whole = rows.iter().all(|row| row[3].fract() == 0.0);
    let grow = sticks.windows(2).all(|pair| pair[0][0][3] < pair[1][0][3]);
    if !are_whole || !grow || rows.len() == sticks.len() || !sticks.iter().all(counts) {
        return false;
    }
    // Lines of a survey may be numbered in this way, too.
    let lines: Vec<[f64; 4]> = rows.iter().map(|r| [r[3], r[4], r[0], r[1]]).collect();
    let mut slopes: Vec<f64> = sticks
        .iter()
        .filter_map(|stick| {
            let (first, last) = (stick.first()?, stick.last()?);
            let distance = (last[0] - first[0]).hypot(last[1] - first[1]);
            (stick.len() > 1).then(|| (last[2] - first[2]).abs() / distance)
        })
        .collect();
    let is_steep = upper_median(&mut slopes).is_some_and(|slope| slope >= MIN_STICK_SLOPE);
    is_steep || line_steps(&lines).is_none()
}

/// Returns the readings of rows without names of columns: x, y, z first, after the numbers of points, or
/// after the numbers of lines, or before these.
fn guesses(columns: &[usize], values: &[f64], width: usize) -> Vec<PlaceReading<3>> {
    let rows = || values.chunks_exact(width);
    let is_whole = |k: usize| rows().all(|row| row[columns[k]].fract() == 0.0);
    let are_consecutive = |k: usize| {
        let column: Vec<f64> = rows().map(|row| row[columns[k]]).collect();
        column.len() > 1 && column.windows(2).all(|pair| pair[1] == pair[0] + 1.0)
    };
    let mut readings = Vec::new();
    let mut add = |at: [usize; 3], lines: Option<[usize; 2]>, is_numbered: bool| {
        readings.push(PlaceReading {
            columns: at.map(|k| columns[k]),
            lines: lines.map(|lines| lines.map(|k| columns[k])),
            is_numbered,
            shift: 0.0,
            coordinates: StatedCoordinates::default(),
            notes: Vec::new(),
        });
    };
    let count = columns.len();
    add([0, 1, 2], None, false);
    if count >= 5 && is_whole(0) && is_whole(1) {
        add([2, 3, 4], Some([0, 1]), false);
    }
    if count >= 5 && is_whole(2) && is_whole(3) {
        add([0, 1, 4], Some([2, 3]), false);
    }
    if count >= 4 && is_whole(0) && are_consecutive(0) {
        add([1, 2, 3], None, true);
        if count >= 6 && is_whole(1) && is_whole(2) {
            add([3, 4, 5], Some([1, 2]), true);
        }
    }
    readings
}
