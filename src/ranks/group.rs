//! Those who share a job, and what they tell one another: all ranks, or threads that stand for them in tests.

use super::{apart, count, each_told, rank};
use crate::Result;
use crate::files::kept::{Kept, bytes};

/// Several that work on one thing, each on a part of its own. All ask the same things in the same order.
pub trait Group: Sync {
    /// Which of them this is, from 0.
    fn rank(&self) -> usize;

    /// How many they are.
    fn count(&self) -> usize;

    /// What each of them has, in their order, on all of them.
    ///
    /// # Errors
    /// Those of the others.
    fn all_bytes(&self, what: &str, own: Vec<u8>) -> Result<Vec<Vec<u8>>>;

    /// What each of them has for this one, in their order; `to` has something for each.
    ///
    /// # Errors
    /// Those of the others.
    fn pass_bytes(&self, what: &str, to: Vec<Vec<u8>>) -> Result<Vec<Vec<u8>>>;
}

impl dyn Group + '_ {
    /// What each of them has, in their order, on all of them.
    ///
    /// # Errors
    /// Those of the others.
    pub fn all<T: Kept>(&self, what: &str, own: T) -> Result<Vec<T>> {
        if self.count() == 1 {
            return Ok(vec![own]);
        }
        let all = self.all_bytes(what, bytes(&own))?;
        heard(what, all, self.rank(), Some(own))
    }

    /// What each of them has for this one, in their order; `to` has something for each.
    ///
    /// # Errors
    /// Those of the others.
    pub fn pass<T: Kept>(&self, what: &str, to: Vec<T>) -> Result<Vec<T>> {
        if self.count() == 1 {
            return Ok(to);
        }
        let (rank, mut own) = (self.rank(), None);
        let of_each = |(to, value): (usize, T)| match to == rank {
            true => {
                own = Some(value);
                Vec::new()
            }
            false => bytes(&value),
        };
        let told = to.into_iter().enumerate().map(of_each).collect();
        heard(what, self.pass_bytes(what, told)?, rank, own)
    }
}

/// What was heard of each, in their order; what is this rank's own is not read back.
fn heard<T: Kept>(
    what: &str,
    all: Vec<Vec<u8>>,
    rank: usize,
    mut own: Option<T>,
) -> Result<Vec<T>> {
    let value = |(from, bytes): (usize, Vec<u8>)| match from == rank {
        true => own.take(),
        false => T::take(&mut &bytes[..]),
    };
    let values = all.into_iter().enumerate().map(value);
    values
        .map(|value| value.ok_or_else(|| apart(what)))
        .collect()
}

/// Lists one after the other. What one alone has stays where it is.
pub fn joined<T>(mut lists: Vec<Vec<T>>) -> Vec<T> {
    match lists.len() {
        1 => lists.pop().unwrap_or_default(),
        _ => lists.into_iter().flatten().collect(),
    }
}

/// One that shares with nobody, whatever ranks there are.
pub struct Alone;

impl Group for Alone {
    fn rank(&self) -> usize {
        0
    }

    fn count(&self) -> usize {
        1
    }

    fn all_bytes(&self, _: &str, own: Vec<u8>) -> Result<Vec<Vec<u8>>> {
        Ok(vec![own])
    }

    fn pass_bytes(&self, _: &str, to: Vec<Vec<u8>>) -> Result<Vec<Vec<u8>>> {
        Ok(to)
    }
}

/// All ranks.
pub struct Ranks;

impl Group for Ranks {
    fn rank(&self) -> usize {
        rank()
    }

    fn count(&self) -> usize {
        count()
    }

    fn all_bytes(&self, what: &str, own: Vec<u8>) -> Result<Vec<Vec<u8>>> {
        if count() == 1 {
            return Ok(vec![own]);
        }
        let mut all = Vec::with_capacity(count());
        each_told(what, Ok(own), &mut |bytes| {
            all.push(bytes);
            Some(())
        })?;
        Ok(all)
    }

    fn pass_bytes(&self, what: &str, to: Vec<Vec<u8>>) -> Result<Vec<Vec<u8>>> {
        if count() == 1 {
            return Ok(to);
        }
        // How much each has for each that it has anything for; and all are here, and none has failed.
        let much = to.iter().map(Vec::len).enumerate();
        let much: Vec<(usize, usize)> = much.filter(|(_, bytes)| *bytes > 0).collect();
        let much: Vec<Vec<(usize, usize)>> = (self as &dyn Group).all(what, much)?;
        let for_this = |told: &Vec<(usize, usize)>| {
            let mut told = told.iter();
            told.find(|(to, _)| *to == rank())
                .map_or(0, |(_, bytes)| *bytes)
        };
        let bytes: Vec<usize> = much.iter().map(for_this).collect();
        Ok(super::world::all_to_all(&to, &bytes))
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::sync::{Condvar, Mutex};

    use super::*;

    /// What threads tell one another.
    struct Table {
        told: Mutex<Vec<Vec<Vec<u8>>>>,
        count: usize,
        met: Mutex<Met>,
        all: Condvar,
    }

    /// How many have come, the how manieth time, and whether one will never come again.
    #[derive(Default)]
    struct Met {
        come: usize,
        times: usize,
        broken: bool,
    }

    impl Table {
        /// Waits for all others.
        fn meet(&self) {
            let mut met = self.met.lock().unwrap();
            met.come += 1;
            if met.come == self.count {
                met.come = 0;
                met.times += 1;
                self.all.notify_all();
            }
            let times = met.times + usize::from(met.come > 0);
            let met = (self.all)
                .wait_while(met, |met| met.times < times && !met.broken)
                .unwrap();
            let broken = met.broken && met.times < times;
            drop(met);
            assert!(!broken, "another thread has failed");
        }
    }

    /// Lets the others go on where this thread fails: they would wait for ever.
    struct Here<'a>(&'a Table);

    impl Drop for Here<'_> {
        fn drop(&mut self) {
            if std::thread::panicking() {
                self.0.met.lock().unwrap().broken = true;
                self.0.all.notify_all();
            }
        }
    }

    /// A thread that stands for a rank.
    struct Thread<'a>(usize, &'a Table);

    impl Group for Thread<'_> {
        fn rank(&self) -> usize {
            self.0
        }

        fn count(&self) -> usize {
            self.1.told.lock().unwrap().len()
        }

        fn all_bytes(&self, what: &str, own: Vec<u8>) -> Result<Vec<Vec<u8>>> {
            self.pass_bytes(what, vec![own; self.count()])
        }

        fn pass_bytes(&self, _: &str, to: Vec<Vec<u8>>) -> Result<Vec<Vec<u8>>> {
            self.1.told.lock().unwrap()[self.0] = to;
            self.1.meet();
            let told = self.1.told.lock().unwrap();
            let for_this = told.iter().map(|to| to[self.0].clone()).collect();
            drop(told);
            self.1.meet();
            Ok(for_this)
        }
    }

    /// What `work` gives on each of so many that share it.
    pub fn shared<T: Send>(count: usize, work: impl Fn(&dyn Group) -> T + Sync) -> Vec<T> {
        let table = Table {
            told: Mutex::new(vec![Vec::new(); count]),
            count,
            met: Mutex::default(),
            all: Condvar::new(),
        };
        std::thread::scope(|scope| {
            let (table, work) = (&table, &work);
            let begin = |rank| {
                scope.spawn(move || {
                    let _here = Here(table);
                    work(&Thread(rank, table))
                })
            };
            let all: Vec<_> = (0..count).map(begin).collect();
            let ended = |one: std::thread::ScopedJoinHandle<'_, T>| match one.join() {
                Ok(value) => value,
                Err(why) => std::panic::resume_unwind(why),
            };
            all.into_iter().map(ended).collect()
        })
    }

    #[test]
    #[should_panic(expected = "failed")]
    fn where_one_fails_the_others_do_not_wait_for_it() {
        shared(3, |group| {
            assert!(group.rank() != 1, "one has failed");
            group.all("numbers", group.rank()).unwrap();
        });
    }

    #[test]
    fn each_hears_what_is_for_it_and_all_what_is_for_all() {
        for count in [1, 2, 5] {
            let heard = shared(count, |group| {
                let own = group.rank();
                let all = group.all("numbers", own).unwrap();
                let to: Vec<String> = (0..count).map(|to| format!("{own} to {to}")).collect();
                (all, group.pass("words", to).unwrap())
            });
            for (rank, (all, words)) in heard.into_iter().enumerate() {
                assert!(all.into_iter().eq(0..count));
                let wanted = (0..count).map(|from| format!("{from} to {rank}"));
                assert!(words.into_iter().eq(wanted));
            }
        }
        for alone in [&Ranks as &dyn Group, &Alone] {
            assert_eq!(alone.pass("numbers", vec![7usize]).unwrap(), [7]);
        }
    }
}
