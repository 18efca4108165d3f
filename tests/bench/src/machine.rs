//! What a clock time was taken on.

use std::fs::read_to_string;
use std::process::Command;

/// Processor, cores, memory, system and compiler in one line; no name of the machine.
pub fn description() -> String {
    let info = read_to_string("/proc/cpuinfo").unwrap_or_default();
    let field = |name: &str| {
        let line = info.lines().find(|l| l.starts_with(name))?;
        Some(line.split_once(':')?.1.trim().to_string())
    };
    let cpu = field("model name").unwrap_or_else(|| "unknown processor".into());
    let frequency = field("cpu MHz").map_or(String::new(), |mhz| format!(" at {mhz} MHz"));
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let memory = read_to_string("/proc/meminfo")
        .ok()
        .and_then(|m| m.lines().next()?.split_whitespace().nth(1)?.parse::<f64>().ok())
        .map_or(String::new(), |kib| format!(", {:.0} GiB of memory", kib / f64::from(1 << 20)));
    let compiler = Command::new("rustc").arg("--version").output();
    let compiler = compiler.ok().and_then(|o| String::from_utf8(o.stdout).ok()).unwrap_or_default();
    // "rustc 1.95.0 (hash date)"
    let compiler = compiler.split(" (").next().unwrap_or_default().trim().to_string();
    let profile = if cfg!(debug_assertions) { "debug" } else { "release" };
    format!(
        "{cpu}{frequency}, {cores} cores{memory}, {} {}; {compiler} ({profile}), one thread",
        std::env::consts::OS,
        std::env::consts::ARCH
    )
}

/// Processes that wanted a core during the last minute, this one included; `None` where the system does not
/// say.
pub fn load() -> Option<f64> {
    read_to_string("/proc/loadavg").ok()?.split_whitespace().next()?.parse().ok()
}
