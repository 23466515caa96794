//! Those who share a job, and what they tell one another: all ranks, or threads that stand for them in tests.

use super::{all_gather_checked, out_of_step_error, rank, size};
use crate::Result;
use crate::files::codec::{Codec, encode_to_vec};

/// Several that work on one thing, each on a part of its own. All ask the same things in the same order.
pub trait Comm: Sync {
    /// Which of them this is, from 0.
    fn rank(&self) -> usize;

    /// How many they are.
    fn size(&self) -> usize;

    /// What each of them has, in their order, on all of them.
    ///
    /// # Errors
    /// Those of the others.
    fn all_gather_bytes(&self, what: &str, own: Vec<u8>) -> Result<Vec<Vec<u8>>>;

    /// What each of them has for this one, in their order; `to` has something for each.
    ///
    /// # Errors
    /// Those of the others.
    fn all_to_all_bytes(&self, what: &str, to: Vec<Vec<u8>>) -> Result<Vec<Vec<u8>>>;
}

impl dyn Comm + '_ {
    /// What each of them has, in their order, on all of them.
    ///
    /// # Errors
    /// Those of the others.
    pub fn all_gather<T: Codec>(&self, what: &str, own: T) -> Result<Vec<T>> {
        if self.size() == 1 {
            return Ok(vec![own]);
        }
        let all = self.all_gather_bytes(what, encode_to_vec(&own))?;
        decode_received(what, all, self.rank(), Some(own))
    }

    /// What each of them has for this one, in their order; `to` has something for each.
    ///
    /// # Errors
    /// Those of the others.
    pub fn all_to_all<T: Codec>(&self, what: &str, to: Vec<T>) -> Result<Vec<T>> {
        if self.size() == 1 {
            return Ok(to);
        }
        let (rank, mut own) = (self.rank(), None);
        let of_each = |(to, value): (usize, T)| match to == rank {
            true => {
                own = Some(value);
                Vec::new()
            }
            false => encode_to_vec(&value),
        };
        let told = to.into_iter().enumerate().map(of_each).collect();
        decode_received(what, self.all_to_all_bytes(what, told)?, rank, own)
    }
}

/// What was heard of each, in their order; what is this rank's own is not read back.
fn decode_received<T: Codec>(
    what: &str,
    all: Vec<Vec<u8>>,
    rank: usize,
    mut own: Option<T>,
) -> Result<Vec<T>> {
    let value = |(from, bytes): (usize, Vec<u8>)| match from == rank {
        true => own.take(),
        false => T::decode(&mut &bytes[..]),
    };
    let values = all.into_iter().enumerate().map(value);
    values
        .map(|value| value.ok_or_else(|| out_of_step_error(what)))
        .collect()
}

/// Lists one after the other. What one alone has stays where it is.
pub fn concatenate<T>(mut lists: Vec<Vec<T>>) -> Vec<T> {
    match lists.len() {
        1 => lists.pop().unwrap_or_default(),
        _ => lists.into_iter().flatten().collect(),
    }
}

/// One that shares with nobody, whatever ranks there are.
pub struct SelfComm;

impl Comm for SelfComm {
    fn rank(&self) -> usize {
        0
    }

    fn size(&self) -> usize {
        1
    }

    fn all_gather_bytes(&self, _: &str, own: Vec<u8>) -> Result<Vec<Vec<u8>>> {
        Ok(vec![own])
    }

    fn all_to_all_bytes(&self, _: &str, to: Vec<Vec<u8>>) -> Result<Vec<Vec<u8>>> {
        Ok(to)
    }
}

/// All ranks.
pub struct WorldComm;

impl Comm for WorldComm {
    fn rank(&self) -> usize {
        rank()
    }

    fn size(&self) -> usize {
        size()
    }

    fn all_gather_bytes(&self, what: &str, own: Vec<u8>) -> Result<Vec<Vec<u8>>> {
        if size() == 1 {
            return Ok(vec![own]);
        }
        let mut all = Vec::with_capacity(size());
        all_gather_checked(what, Ok(own), &mut |bytes| {
            all.push(bytes);
            Some(())
        })?;
        Ok(all)
    }

    fn all_to_all_bytes(&self, what: &str, to: Vec<Vec<u8>>) -> Result<Vec<Vec<u8>>> {
        if size() == 1 {
            return Ok(to);
        }
        // How much each has for each that it has anything for; and all are here, and none has failed.
        let much = to.iter().map(Vec::len).enumerate();
        let much: Vec<(usize, usize)> = much.filter(|(_, bytes)| *bytes > 0).collect();
        let much: Vec<Vec<(usize, usize)>> = (self as &dyn Comm).all_gather(what, much)?;
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
    struct Mailbox {
        sent: Mutex<Vec<Vec<Vec<u8>>>>,
        count: usize,
        barrier: Mutex<BarrierState>,
        condvar: Condvar,
    }

    /// How many have come, the how manieth time, and whether one will never come again.
    #[derive(Default)]
    struct BarrierState {
        arrived_count: usize,
        generation: usize,
        is_broken: bool,
    }

    impl Mailbox {
        /// Waits for all others.
        fn wait_for_all(&self) {
            let mut met = self.barrier.lock().unwrap();
            met.arrived_count += 1;
            if met.arrived_count == self.count {
                met.arrived_count = 0;
                met.generation += 1;
                self.condvar.notify_all();
            }
            let times = met.generation + usize::from(met.arrived_count > 0);
            let met = (self.condvar)
                .wait_while(met, |met| met.generation < times && !met.is_broken)
                .unwrap();
            let broken = met.is_broken && met.generation < times;
            drop(met);
            assert!(!broken, "another thread has failed");
        }
    }

    /// Lets the others go on where this thread fails: they would wait for ever.
    struct PanicGuard<'a>(&'a Mailbox);

    impl Drop for PanicGuard<'_> {
        fn drop(&mut self) {
            if std::thread::panicking() {
                self.0.barrier.lock().unwrap().is_broken = true;
                self.0.condvar.notify_all();
            }
        }
    }

    /// A thread that stands for a rank.
    struct ThreadComm<'a>(usize, &'a Mailbox);

    impl Comm for ThreadComm<'_> {
        fn rank(&self) -> usize {
            self.0
        }

        fn size(&self) -> usize {
            self.1.sent.lock().unwrap().len()
        }

        fn all_gather_bytes(&self, what: &str, own: Vec<u8>) -> Result<Vec<Vec<u8>>> {
            self.all_to_all_bytes(what, vec![own; self.size()])
        }

        fn all_to_all_bytes(&self, _: &str, to: Vec<Vec<u8>>) -> Result<Vec<Vec<u8>>> {
            self.1.sent.lock().unwrap()[self.0] = to;
            self.1.wait_for_all();
            let told = self.1.sent.lock().unwrap();
            let for_this = told.iter().map(|to| to[self.0].clone()).collect();
            drop(told);
            self.1.wait_for_all();
            Ok(for_this)
        }
    }

    /// What `work` gives on each of so many that share it.
    pub fn run_threads<T: Send>(count: usize, work: impl Fn(&dyn Comm) -> T + Sync) -> Vec<T> {
        let table = Mailbox {
            sent: Mutex::new(vec![Vec::new(); count]),
            count,
            barrier: Mutex::default(),
            condvar: Condvar::new(),
        };
        std::thread::scope(|scope| {
            let (table, work) = (&table, &work);
            let begin = |rank| {
                scope.spawn(move || {
                    let _here = PanicGuard(table);
                    work(&ThreadComm(rank, table))
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
        run_threads(3, |group| {
            assert!(group.rank() != 1, "one has failed");
            group.all_gather("numbers", group.rank()).unwrap();
        });
    }

    #[test]
    fn each_hears_what_is_for_it_and_all_what_is_for_all() {
        for count in [1, 2, 5] {
            let heard = run_threads(count, |group| {
                let own = group.rank();
                let all = group.all_gather("numbers", own).unwrap();
                let to: Vec<String> = (0..count).map(|to| format!("{own} to {to}")).collect();
                (all, group.all_to_all("words", to).unwrap())
            });
            for (rank, (all, words)) in heard.into_iter().enumerate() {
                assert!(all.into_iter().eq(0..count));
                let wanted = (0..count).map(|from| format!("{from} to {rank}"));
                assert!(words.into_iter().eq(wanted));
            }
        }
        for alone in [&WorldComm as &dyn Comm, &SelfComm] {
            assert_eq!(alone.all_to_all("numbers", vec![7usize]).unwrap(), [7]);
        }
    }
}
