//! Threads in place of the ranks of MPI, so that tests need no MPI.

use std::sync::{Condvar, Mutex};

use super::world::World;
use super::{Comm, MpiComm};

/// Messages that threads send one another.
struct Mailbox {
    /// For each thread, what it sends to each thread.
    sent: Mutex<Vec<Vec<Vec<u8>>>>,
    size: usize,
    barrier: Mutex<BarrierState>,
    condvar: Condvar,
}

/// State of a barrier that can break.
#[derive(Default)]
struct BarrierState {
    arrived_count: usize,
    /// How many times all threads have met.
    generation: usize,
    /// `true` if a thread has failed, and will not arrive.
    is_broken: bool,
}

impl Mailbox {
    /// Waits for all other threads.
    fn wait_for_all(&self) {
        let mut state = self.barrier.lock().unwrap();
        state.arrived_count += 1;
        if state.arrived_count == self.size {
            state.arrived_count = 0;
            state.generation += 1;
            self.condvar.notify_all();
        }
        let target = state.generation + usize::from(state.arrived_count > 0);
        let state = (self.condvar)
            .wait_while(state, |state| state.generation < target && !state.is_broken)
            .unwrap();
        let is_broken = state.is_broken && state.generation < target;
        drop(state);
        assert!(!is_broken, "another thread has failed");
    }

    /// Sends `to[k]` to the thread `k`, and returns what the thread `rank` receives of each.
    fn exchange(&self, rank: usize, to: Vec<Vec<u8>>) -> Vec<Vec<u8>> {
        self.sent.lock().unwrap()[rank] = to;
        self.wait_for_all();
        let sent = self.sent.lock().unwrap();
        let received = sent.iter().map(|to| to[rank].clone()).collect();
        drop(sent);
        self.wait_for_all();
        received
    }
}

/// Lets the other threads go on if this one panics: they would wait endlessly.
struct PanicGuard<'a>(&'a Mailbox);

impl Drop for PanicGuard<'_> {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.0.barrier.lock().unwrap().is_broken = true;
            self.0.condvar.notify_all();
        }
    }
}

/// The threads, as one of them sees them. [`MpiComm`] on top of it is the communicator of threads, which so has the
/// same checks as that of ranks.
struct ThreadWorld<'a> {
    rank: usize,
    mailbox: &'a Mailbox,
}

impl World for ThreadWorld<'_> {
    fn rank(&self) -> usize {
        self.rank
    }

    fn size(&self) -> usize {
        self.mailbox.size
    }

    fn all_gather_headers(&self, own: [u64; 3]) -> Vec<[u64; 3]> {
        let bytes = own.map(u64::to_le_bytes).as_flattened().to_vec();
        let all = self.mailbox.exchange(self.rank, vec![bytes; self.size()]);
        let number = |bytes: &[u8]| u64::from_le_bytes(bytes.try_into().unwrap());
        all.iter()
            .map(|bytes| [0, 8, 16].map(|at| number(&bytes[at..at + 8])))
            .collect()
    }

    fn all_gather(&self, own: &[u8], lengths: &[usize]) -> Vec<u8> {
        let all = (self.mailbox).exchange(self.rank, vec![own.to_vec(); self.size()]);
        assert!(all.iter().map(Vec::len).eq(lengths.iter().copied()));
        all.concat()
    }

    fn broadcast(&self, root: usize, bytes: &mut [u8]) {
        let all = (self.mailbox).exchange(self.rank, vec![bytes.to_vec(); self.size()]);
        bytes.copy_from_slice(&all[root]);
    }

    fn all_to_all(&self, to: &[Vec<u8>], lengths: &[usize]) -> Vec<Vec<u8>> {
        let received = self.mailbox.exchange(self.rank, to.to_vec());
        assert!(received.iter().map(Vec::len).eq(lengths.iter().copied()));
        received
    }
}

/// Runs `work` in `size` threads that share a communicator, and returns what it returns in each.
pub fn run_threads<T: Send>(size: usize, work: impl Fn(&dyn Comm) -> T + Sync) -> Vec<T> {
    let mailbox = Mailbox {
        sent: Mutex::new(vec![Vec::new(); size]),
        size,
        barrier: Mutex::default(),
        condvar: Condvar::new(),
    };
    std::thread::scope(|scope| {
        let (mailbox, work) = (&mailbox, &work);
        let begin = |rank| {
            scope.spawn(move || {
                let _guard = PanicGuard(mailbox);
                work(&MpiComm::new(Box::new(ThreadWorld { rank, mailbox })))
            })
        };
        let threads: Vec<_> = (0..size).map(begin).collect();
        let result = |thread: std::thread::ScopedJoinHandle<'_, T>| match thread.join() {
            Ok(value) => value,
            Err(panic) => std::panic::resume_unwind(panic),
        };
        threads.into_iter().map(result).collect()
    })
}

#[test]
#[should_panic(expected = "failed")]
fn if_one_thread_fails_the_others_do_not_wait_for_it() {
    run_threads(3, |comm| {
        assert!(comm.rank() != 1, "one has failed");
        comm.all_gather("numbers", comm.rank()).unwrap();
    });
}
