//! What this machine can do, to measure others against: float32 multiply-adds a second from
//! registers, and bytes a second read from memory. The best of several rounds, because whatever
//! else runs can only slow them down.
//!
//! ```text
//! cargo bench --bench machine -- [--threads T] [--mib SIZE] [--json]
//! ```

use std::hint::black_box;
use std::process::ExitCode;
use std::sync::Barrier;
use std::thread;
use std::time::{Duration, Instant};

use pulp::{Arch, Simd, WithSimd};
use serde_json::json;

/// Chains of dependent operations. A multiply-add takes 4 cycles on common processors, which start
/// at most 2 a cycle: 8 chains fill them. With two constants, 12 still fit into 16 registers.
const CHAINS: usize = 12;
const ROUNDS: usize = 9;
const ROUND_TIME: Duration = Duration::from_millis(60);
const DEFAULT_MIB: usize = 512;

const USAGE: &str = "options: --threads T (default: one for each processor), \
                     --mib SIZE to read (default: 512), \
                     --json (to standard output; the text then goes to standard error)";

/// `steps` multiply-adds in each lane of each chain.
#[derive(Clone, Copy)]
struct MultiplyAdds {
    steps: usize,
}

impl MultiplyAdds {
    fn flops(self) -> f64 {
        (2 * CHAINS * lanes() * self.steps) as f64
    }
}

impl WithSimd for MultiplyAdds {
    type Output = f32;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f32 {
        // Values from black boxes, or the compiler would work out chains that are alike only once.
        let factor = simd.splat_f32s(black_box(0.5));
        let addend = simd.splat_f32s(black_box(1.0));
        let mut chains: [S::f32s; CHAINS] =
            std::array::from_fn(|i| simd.splat_f32s(black_box(i as f32)));
        for _ in 0..self.steps {
            for chain in &mut chains {
                *chain = simd.mul_add_e_f32s(*chain, factor, addend);
            }
        }
        total(simd, chains)
    }
}

/// The sum of an array.
struct Sum<'a>(&'a [f32]);

impl WithSimd for Sum<'_> {
    type Output = f32;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f32 {
        let (vectors, rest) = S::as_simd_f32s(self.0);
        let (groups, odd) = vectors.as_chunks::<CHAINS>();
        let mut sums = [simd.splat_f32s(0.0); CHAINS];
        for group in groups {
            for i in 0..CHAINS {
                sums[i] = simd.add_f32s(sums[i], group[i]);
            }
        }
        for vector in odd {
            sums[0] = simd.add_f32s(sums[0], *vector);
        }
        total(simd, sums) + rest.iter().sum::<f32>()
    }
}

#[inline(always)]
fn total<S: Simd>(simd: S, vectors: [S::f32s; CHAINS]) -> f32 {
    vectors.map(|v| simd.reduce_sum_f32s(v)).iter().sum()
}

/// float32 numbers in a vector of the instruction set that is used.
fn lanes() -> usize {
    struct Lanes;
    impl WithSimd for Lanes {
        type Output = usize;

        #[inline(always)]
        fn with_simd<S: Simd>(self, _: S) -> usize {
            S::F32_LANES
        }
    }
    Arch::new().dispatch(Lanes)
}

/// The shortest time in which all of `threads` threads have done `work` once.
///
/// `prepare` makes each thread's own data, on that thread: memory then lies near its processor.
fn best_time<D>(
    threads: usize,
    prepare: impl Fn() -> D + Sync,
    work: impl Fn(&D) -> f32 + Sync,
) -> f64 {
    let barrier = Barrier::new(threads);
    let run = || {
        let data = prepare();
        black_box(work(&data)); // warm up
        let span = |_| {
            barrier.wait();
            let start = Instant::now();
            black_box(work(&data));
            (start, Instant::now())
        };
        (0..ROUNDS).map(span).collect::<Vec<_>>()
    };
    let spans: Vec<_> = thread::scope(|scope| {
        let handles: Vec<_> = (0..threads).map(|_| scope.spawn(run)).collect();
        handles
            .into_iter()
            .map(|handle| handle.join().expect("no panic"))
            .collect()
    });
    (0..ROUNDS)
        .map(|round| {
            let start = spans.iter().map(|of_thread| of_thread[round].0).min();
            let end = spans.iter().map(|of_thread| of_thread[round].1).max();
            end.zip(start)
                .map_or(f64::NAN, |(end, start)| (end - start).as_secs_f64())
        })
        .fold(f64::INFINITY, f64::min)
}

/// float32 operations a second, in 10⁹; a multiply-add counts as two.
fn multiply_add_rate(threads: usize) -> f64 {
    let mut work = MultiplyAdds { steps: 1024 };
    loop {
        let start = Instant::now();
        black_box(Arch::new().dispatch(black_box(work)));
        if start.elapsed() >= ROUND_TIME {
            break;
        }
        work.steps *= 2;
    }
    let time = best_time(threads, || (), |()| Arch::new().dispatch(black_box(work)));
    threads as f64 * work.flops() / time * 1e-9
}

/// Bytes a second that the threads together read from `mib` MiB, in 10⁹.
fn read_rate(threads: usize, mib: usize) -> f64 {
    let length = (mib << 20) / size_of::<f32>() / threads;
    let time = best_time(
        threads,
        || vec![1.0; length],
        |data| Arch::new().dispatch(Sum(data)),
    );
    (threads * length * size_of::<f32>()) as f64 / time * 1e-9
}

struct Options {
    threads: usize,
    mib: usize,
    json: bool,
}

impl Options {
    fn parse(mut arguments: impl Iterator<Item = String>) -> Result<Self, String> {
        let mut options = Self {
            threads: thread::available_parallelism().map_or(1, usize::from),
            mib: DEFAULT_MIB,
            json: false,
        };
        while let Some(name) = arguments.next() {
            match name.as_str() {
                "--bench" => {} // cargo bench says so
                "--json" => options.json = true,
                "--threads" | "--mib" => {
                    let value = arguments.next();
                    let number = value.as_deref().and_then(|v| v.parse().ok());
                    let number = number.filter(|&n: &usize| n > 0).ok_or_else(|| {
                        let found = value.unwrap_or("nothing".to_owned());
                        format!("{name}: expected a whole number from 1, found {found}")
                    })?;
                    match name.as_str() {
                        "--threads" => options.threads = number,
                        _ => options.mib = number,
                    }
                }
                _ => return Err(format!("unknown option {name}; {USAGE}")),
            }
        }
        Ok(options)
    }
}

fn main() -> ExitCode {
    let Options { threads, mib, json } = match Options::parse(std::env::args().skip(1)) {
        Ok(options) => options,
        Err(message) => {
            eprintln!("{message}");
            return ExitCode::from(2);
        }
    };
    let counts = if threads == 1 {
        vec![1]
    } else {
        vec![1, threads]
    };
    let measured: Vec<_> = counts
        .iter()
        .map(|&threads| (threads, multiply_add_rate(threads), read_rate(threads, mib)))
        .collect();
    let bits = 32 * lanes();
    let mut text =
        format!("{bits}-bit vectors\nthreads   float32 multiply-add   memory read, {mib} MiB\n");
    for (threads, flops, bytes) in &measured {
        text += &format!("{threads:>7}   {flops:>12.1} GFLOP/s   {bytes:>11.1} GB/s\n");
    }
    if json {
        let rows: Vec<_> = measured
            .iter()
            .map(|(threads, flops, bytes)| {
                json!({"threads": threads, "fma_gflops": flops, "memory_gbs": bytes})
            })
            .collect();
        eprint!("{text}");
        println!("{:#}", json!({"vector_bits": bits, "measured": rows}));
    } else {
        print!("{text}");
    }
    ExitCode::SUCCESS
}
