//! Times of the kernels: `cargo bench -p bench`, or with a filter, `cargo bench -p bench -- twisting`.

use bench::kernels::KERNELS;
use divan::Bencher;

fn main() {
    divan::main();
}

#[divan::bench(args = KERNELS.iter().map(|k| k.name))]
fn kernel(bencher: Bencher, name: &str) {
    let kernel = KERNELS.iter().find(|k| k.name == name).expect("one of those listed");
    let mut bencher = Some(bencher);
    let run = &mut |call: &mut dyn FnMut()| bencher.take().expect("called once").bench_local(call);
    kernel.with(run).expect("a kernel that can be set up");
}
