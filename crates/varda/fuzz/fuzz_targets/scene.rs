#![no_main]

#[allow(dead_code)]
#[path = "../../tests/support/harness.rs"]
mod harness;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    harness::scene(bytes);
});
