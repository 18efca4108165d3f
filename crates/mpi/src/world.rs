//! The processes of an MPI job as [`Ranks`].

use std::cell::{Cell, RefCell};
use std::time::{Duration, Instant};

use mpi::datatype::PartitionMut;
use mpi::environment::{Universe, processor_name};
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator, CommunicatorCollectives};
use varda_assimilation::ranks::Ranks;

/// All processes of the job. Before anything is gathered every rank says what it is about to do, so that none
/// waits for one that has failed, and hosts that came to different numbers are found out.
pub(crate) struct World {
    communicator: SimpleCommunicator,
    /// Taken at the end: dropping it ends the use of MPI.
    universe: RefCell<Option<Universe>>,
    gathers: Cell<usize>,
    bytes: Cell<usize>,
    waited: Cell<Duration>,
    /// Whether CPU seconds are read.
    counts: bool,
    /// CPU seconds in gathers.
    idle: Cell<f64>,
}

/// What a rank says before a gather: what it is about to do, a checksum of what its numbers follow from, and
/// how many they are.
type Header = [u64; 3];

/// What a rank is about to do: to gather, or to end, with or without an error.
const GATHERS: u64 = 0;
const ENDS: u64 = 1;
const FAILS: u64 = 2;

/// What the gathers of a job came to.
pub(crate) struct Tally {
    pub(crate) ranks: usize,
    pub(crate) gathers: usize,
    /// Received by each rank, its own included.
    pub(crate) bytes: usize,
    /// In gathers, waiting for others included, of the rank that waited longest \[s\].
    pub(crate) longest: f64,
    /// Of the one that waited least \[s\].
    pub(crate) shortest: f64,
    /// CPU seconds outside of gathers, of the rank with most and of the one with least; NaN where the system
    /// does not tell them.
    pub(crate) busiest: f64,
    /// See there.
    pub(crate) idlest: f64,
}

impl World {
    /// `counts` says whether CPU seconds are read, some microseconds a gather.
    pub(crate) fn new(universe: Universe, counts: bool) -> Self {
        World {
            communicator: universe.world(),
            universe: RefCell::new(Some(universe)),
            gathers: Cell::new(0),
            bytes: Cell::new(0),
            waited: Cell::new(Duration::ZERO),
            counts,
            idle: Cell::new(0.0),
        }
    }

    /// Ends the job with the other ranks. Returns where none has failed, after its last message.
    pub(crate) fn end(&self, failure: Option<String>) -> Tally {
        let says = [if failure.is_some() { FAILS } else { ENDS }, 0, 0];
        let headers = self.say(says);
        if headers.iter().any(|header| header[0] != ENDS) {
            self.give_up(&headers, failure);
        }
        let mine = [self.waited.get().as_secs_f64(), self.cpu() - self.idle.get()];
        let mut all = vec![0.0; mine.len() * self.count()];
        self.communicator.all_gather_into(&mine[..], &mut all[..]);
        self.universe.take();
        let of = |i: usize, start: f64, f: fn(f64, f64) -> f64| {
            all.iter().skip(i).step_by(2).copied().fold(start, f)
        };
        Tally {
            ranks: all.len() / mine.len(),
            gathers: self.gathers.get(),
            bytes: self.bytes.get(),
            longest: of(0, 0.0, f64::max),
            shortest: of(0, f64::INFINITY, f64::min),
            busiest: of(1, f64::NAN, f64::max),
            idlest: of(1, f64::NAN, f64::min),
        }
    }

    /// CPU seconds of this process, where Linux tells them and they are asked for.
    fn cpu(&self) -> f64 {
        if self.counts { cpu_seconds().unwrap_or(f64::NAN) } else { f64::NAN }
    }

    /// The headers of all ranks.
    fn say(&self, header: Header) -> Vec<Header> {
        let mut all = vec![0_u64; header.len() * self.count()];
        self.communicator.all_gather_into(&header[..], &mut all[..]);
        all.chunks_exact(header.len()).map(|h| [h[0], h[1], h[2]]).collect()
    }

    /// The items of all ranks, those of rank 0 first.
    fn gather<T>(&self, mine: &[T], lengths: &[usize]) -> Result<Vec<T>, String>
    where
        T: Clone + Default + mpi::traits::Equivalence,
    {
        let total: usize = lengths.iter().sum();
        let number =
            |n: usize| i32::try_from(n).map_err(|_| format!("{total} numbers are too many to gather"));
        let counts = lengths.iter().map(|n| number(*n)).collect::<Result<Vec<i32>, String>>()?;
        number(total)?;
        let firsts: Vec<i32> =
            counts.iter().scan(0, |sum, n| Some(std::mem::replace(sum, *sum + n))).collect();
        let mut all = vec![T::default(); total];
        let mut partition = PartitionMut::new(&mut all[..], counts, &firsts[..]);
        self.communicator.all_gather_varcount_into(mine, &mut partition);
        Ok(all)
    }

    /// Ends all processes of the job, which have all come here; rank 0 tells why.
    fn give_up(&self, headers: &[Header], failure: Option<String>) -> ! {
        let host = processor_name().unwrap_or_default();
        let text = format!("{host}\n{}", failure.unwrap_or_default()).into_bytes();
        let lengths: Vec<usize> =
            self.say([text.len() as u64, 0, 0]).iter().map(|header| header[0] as usize).collect();
        let all = self.gather(&text, &lengths).unwrap_or_default();
        if self.rank() == 0 {
            let mut rest = &all[..];
            let texts = lengths.iter().map(|length| {
                let (text, others) = rest.split_at((*length).min(rest.len()));
                rest = others;
                String::from_utf8_lossy(text).into_owned()
            });
            let told: Vec<(String, String)> = texts
                .map(|text| {
                    text.split_once('\n').map(|(host, why)| (host.into(), why.into())).unwrap_or_default()
                })
                .collect();
            eprint!("{}", reasons(headers, &told));
        }
        self.universe.take();
        std::process::exit(1)
    }
}

impl Ranks for World {
    fn rank(&self) -> usize {
        self.communicator.rank() as usize
    }

    fn count(&self) -> usize {
        self.communicator.size() as usize
    }

    fn all_gather(&self, inputs: &[f64], mine: &[f64]) -> Vec<f64> {
        let (started, cpu) = (Instant::now(), self.cpu());
        let headers = self.say([GATHERS, checksum(inputs), mine.len() as u64]);
        if headers.iter().any(|header| header[..2] != headers[0][..2] || header[0] != GATHERS) {
            self.give_up(&headers, None);
        }
        let lengths: Vec<usize> = headers.iter().map(|header| header[2] as usize).collect();
        let all = self.gather(mine, &lengths).unwrap_or_else(|why| {
            // the same on all ranks
            self.end(Some(why));
            Vec::new()
        });
        self.gathers.set(self.gathers.get() + 1);
        self.bytes.set(self.bytes.get() + 8 * all.len() + size_of::<Header>() * headers.len());
        self.waited.set(self.waited.get() + started.elapsed());
        self.idle.set(self.idle.get() + self.cpu() - cpu);
        all
    }
}

/// CPU seconds of the threads of this process.
fn cpu_seconds() -> Option<f64> {
    let mut nanoseconds = 0;
    for thread in std::fs::read_dir("/proc/self/task").ok()?.flatten() {
        let text = std::fs::read_to_string(thread.path().join("schedstat")).ok()?;
        nanoseconds += text.split_whitespace().next()?.parse::<u64>().ok()?;
    }
    Some(1e-9 * nanoseconds as f64)
}

/// Why a job ends, a line for each rank at fault; one for all where they say the same. `told` are host and
/// error of each rank.
fn reasons(headers: &[Header], told: &[(String, String)]) -> String {
    let failed = |rank: &usize| !told[*rank].1.is_empty();
    if (0..told.len()).all(|rank| failed(&rank) && told[rank].1 == told[0].1) {
        return format!("error: {}\n", told[0].1.trim_end());
    }
    let failures: Vec<usize> = (0..told.len()).filter(failed).collect();
    let line =
        |rank: usize, why: &str| format!("error: rank {rank} on {}: {}\n", told[rank].0, why.trim_end());
    if !failures.is_empty() {
        return failures.iter().map(|rank| line(*rank, &told[*rank].1)).collect();
    }
    let why = "it has come to other numbers than rank 0: other files, another version or another kind of \
               processor";
    (1..told.len())
        .filter(|rank| headers[*rank][..2] != headers[0][..2])
        .map(|rank| line(rank, why))
        .collect()
}

/// FNV-1a over the bits.
fn checksum(numbers: &[f64]) -> u64 {
    let mix = |hash: u64, byte: u8| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
    numbers.iter().flat_map(|x| x.to_bits().to_le_bytes()).fold(0xcbf2_9ce4_8422_2325, mix)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(texts: &[&str]) -> Vec<(String, String)> {
        texts.iter().enumerate().map(|(i, text)| (format!("host{i}"), text.to_string())).collect()
    }

    #[test]
    fn who_is_at_fault_is_named() {
        let [work, fail] = [[GATHERS, 7, 3], [FAILS, 0, 0]];
        let same = reasons(&[fail, fail], &told(&["no scene\n", "no scene\n"]));
        assert_eq!(same, "error: no scene\n");
        let one = reasons(&[work, fail, work], &told(&["", "no file", ""]));
        assert_eq!(one, "error: rank 1 on host1: no file\n");
        let other = reasons(&[work, work, [GATHERS, 8, 3]], &told(&["", "", ""]));
        assert!(other.starts_with("error: rank 2 on host2: it has come to other numbers"), "{other}");
        assert_eq!(other.lines().count(), 1);
    }

    #[test]
    fn a_checksum_sees_every_bit() {
        assert_ne!(checksum(&[0.0, 1.0]), checksum(&[-0.0, 1.0]));
        assert_ne!(checksum(&[0.0, 1.0]), checksum(&[1.0, 0.0]));
        assert_eq!(checksum(&[f64::NAN]), checksum(&[f64::NAN]));
    }
}
