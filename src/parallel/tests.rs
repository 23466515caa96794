//! Every loop returns the result of the ordinary iterator of the same name, for any number of
//! threads and items.

use super::prelude::*;

/// Calls `check` with several numbers of items, on one thread and on three.
fn for_counts(check: impl Fn(usize) + Sync) {
    for threads in [1, 3] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        pool.build().unwrap().install(|| {
            for count in [0, 1, 2, 95, 96, 97, 1000] {
                check(count);
            }
        });
    }
}

#[test]
fn items_keep_their_order() {
    for_counts(|count| {
        let items: Vec<usize> = (0..count).map(|i| i * i).collect();
        let squares: Vec<usize> = (0..count).into_par_iter().map(|i| i * i).collect();
        assert_eq!(squares, items);
        assert_eq!(items.par_iter().copied().collect::<Vec<_>>(), items);
        let owned: Vec<String> = items.iter().map(usize::to_string).collect();
        assert_eq!(owned.clone().into_par_iter().collect::<Vec<_>>(), owned);
        let from_five: Vec<u32> = (5..5 + count as u32).into_par_iter().collect();
        assert!(from_five.into_iter().eq(5..5 + count as u32));
        let limited = items.par_iter().with_min_len(50).map(|&i| i);
        assert_eq!(limited.collect::<Vec<_>>(), items);
        let limited = items.par_iter().with_max_len(1).map(|&i| i);
        assert_eq!(limited.collect::<Vec<_>>(), items);
        let mut extended = vec![7];
        extended.par_extend(items.par_iter().map(|&i| i));
        assert_eq!((extended[0], &extended[1..]), (7, &items[..]));
    });
}

#[test]
fn enumerate_zip_and_chunks_match_std() {
    for_counts(|count| {
        let items: Vec<usize> = (0..count).map(|i| 3 * i).collect();
        let numbered: Vec<(usize, &usize)> = items.par_iter().enumerate().collect();
        assert!(numbered.into_iter().eq(items.iter().enumerate()));
        // The loop ends with the shorter one.
        let fewer = &items[..count / 2];
        let pairs: Vec<(&usize, &usize)> = items.par_iter().zip(fewer).collect();
        assert!(pairs.into_iter().eq(items.iter().zip(fewer)));
        for size in [1, 7, 2000] {
            let chunks: Vec<(usize, &[usize])> = items.par_chunks(size).enumerate().collect();
            assert!(chunks.into_iter().eq(items.chunks(size).enumerate()));
            let mut changed = items.clone();
            let chunks = changed.par_chunks_mut(size).enumerate();
            chunks.for_each(|(index, chunk)| chunk.iter_mut().for_each(|i| *i += index));
            let expected = items.iter().enumerate().map(|(at, i)| i + at / size);
            assert!(changed.into_iter().eq(expected));
        }
        let mut changed = items.clone();
        changed.par_iter_mut().for_each(|i| *i += 1);
        assert!(changed.iter().copied().eq(items.iter().map(|i| i + 1)));
    });
}

#[test]
fn filters_and_flat_map_match_std() {
    for_counts(|count| {
        let even = |i: &usize| i.is_multiple_of(2);
        let kept: Vec<usize> = (0..count).into_par_iter().filter(even).collect();
        assert!(kept.into_iter().eq((0..count).filter(even)));
        let half = |i: usize| even(&i).then_some(i / 2);
        let halves: Vec<usize> = (0..count).into_par_iter().filter_map(half).collect();
        assert!(halves.into_iter().eq((0..count).filter_map(half)));
        let twice: Vec<usize> = (0..count)
            .into_par_iter()
            .flat_map_iter(|i| [i; 2])
            .collect();
        assert!(twice.into_iter().eq((0..count).flat_map(|i| [i; 2])));
        let all: Vec<usize> = (0..count)
            .into_par_iter()
            .take_any_while(|_| true)
            .collect();
        assert_eq!(all.len(), count);
        let none = (0..count).into_par_iter().take_any_while(|_| false);
        assert_eq!(none.count(), 0);
    });
}

#[test]
fn reductions_match_std() {
    for_counts(|count| {
        let items = || (0..count).into_par_iter().map(|i| (i * 7919) % 1009);
        let ordinary = || (0..count).map(|i| (i * 7919) % 1009);
        assert_eq!(items().sum::<usize>(), ordinary().sum::<usize>());
        assert_eq!(items().count(), count);
        assert_eq!(
            (items().min(), items().max()),
            (ordinary().min(), ordinary().max())
        );
        assert_eq!(
            items().reduce(|| 0, usize::max),
            ordinary().fold(0, usize::max)
        );
        let folded = items()
            .fold(|| 0, |sum, i| sum + i)
            .reduce(|| 0, |a, b| a + b);
        assert_eq!(folded, ordinary().sum::<usize>());
        assert_eq!(items().any(|i| i == 500), ordinary().any(|i| i == 500));
        assert_eq!(items().all(|i| i < 500), ordinary().all(|i| i < 500));
        assert_eq!(
            items().position_first(|i| i > 900),
            ordinary().position(|i| i > 900)
        );
        let (a, b): (Vec<usize>, Vec<usize>) = items().map(|i| (i, i + 1)).unzip();
        assert!(a.into_iter().zip(b).eq(ordinary().map(|i| (i, i + 1))));
    });
}

#[test]
fn the_first_error_is_returned_and_each_piece_has_its_own_state() {
    for_counts(|count| {
        let fails_from =
            |first_failure: usize| move |i: usize| if i < first_failure { Ok(i) } else { Err(i) };
        let all: Result<Vec<usize>, usize> =
            (0..count).into_par_iter().map(fails_from(count)).collect();
        assert!(all.unwrap().into_iter().eq(0..count));
        if count > 90 {
            let failed: Result<Vec<usize>, usize> =
                (0..count).into_par_iter().map(fails_from(90)).collect();
            assert_eq!(failed, Err(90));
            let none: Option<Vec<usize>> = (0..count)
                .into_par_iter()
                .map(|i| (i < 90).then_some(i))
                .collect();
            assert_eq!(none, None);
            let result = (0..count)
                .into_par_iter()
                .try_for_each(|i| fails_from(0)(i).map(|_| ()));
            assert!(result.is_err());
        }
        let state = |seen: &mut Vec<usize>, i: usize| {
            seen.push(i);
            seen.len()
        };
        let seen: Vec<usize> = (0..count)
            .into_par_iter()
            .map_init(Vec::new, state)
            .collect();
        // The state of a piece has seen only the items of this piece.
        assert_eq!(seen.first().copied(), (count > 0).then_some(1));
        assert!(
            seen.windows(2)
                .all(|pair| pair[1] == pair[0] + 1 || pair[1] == 1)
        );
    });
}

#[test]
fn sorting_matches_std() {
    for_counts(|count| {
        let items: Vec<usize> = (0..count).map(|i| (i * 7919) % 101).collect();
        let mut sorted = items.clone();
        sorted.sort_unstable();
        let mut parallel = items.clone();
        parallel.par_sort_unstable();
        assert_eq!(parallel, sorted);
        parallel.par_sort_unstable_by(|a, b| b.cmp(a));
        assert!(parallel.iter().rev().eq(&sorted));
        // Equal items keep their order.
        let mut numbered: Vec<(usize, usize)> = items.iter().copied().enumerate().collect();
        numbered.par_sort_by_key(|&(_, item)| item);
        assert!(numbered.is_sorted_by_key(|&(at, item)| (item, at)));
    });
}
