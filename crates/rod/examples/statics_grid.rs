//! Robustness grid and fixtures; prints a table. Development only.
use std::time::Instant;
use varda_rod::*;

fn section(ea: f64, ei: f64, gj: f64, m: f64) -> Section {
    Section { ea, ei1: ei, ei2: ei, gj, mass_per_length: m }
}
fn v3(v: &serde_json::Value) -> Vector3<f64> {
    Vector3::new(v[0].as_f64().unwrap(), v[1].as_f64().unwrap(), v[2].as_f64().unwrap())
}
fn nums(line: &str, key: &str) -> Vec<f64> {
    let i = line.find(&format!("{key} = ")).unwrap() + key.len() + 3;
    let r = &line[i..];
    let r = if r.starts_with('[') {
        &r[1..r.find(']').unwrap()]
    } else {
        r.split([',', '}', '\n']).next().unwrap()
    };
    r.split(',').map(|x| x.trim().trim_end_matches([']', '}']).trim().parse().unwrap()).collect()
}
fn cables() {
    let dir = "/work/shared/field-cases/slack-cable-two-hooks";
    let (mut ok, mut worst, mut iters, t0) = (0, 0.0f64, vec![], Instant::now());
    for c in 0..56 {
        let text = std::fs::read_to_string(format!("{dir}/c{c:02}.toml")).unwrap();
        let line = |k: &str| {
            text.lines().find(|l| l.starts_with(k)).unwrap_or_else(|| panic!("{k} in {c}")).to_string()
        };
        let (length, n) =
            (nums(&line("length"), "length")[0], nums(&line("segments"), "segments")[0] as usize);
        let s = line("section");
        let rod = Rod::uniform(
            length,
            n,
            &section(nums(&s, "ea")[0], nums(&s, "ei")[0], nums(&s, "gj")[0], nums(&s, "mass_per_length")[0]),
        )
        .unwrap();
        let g = nums(&line("gravity"), "gravity");
        let p = line("prescribed");
        let second = &p[p.rfind("position").unwrap()..];
        let q = nums(second, "position");
        let p = nums(&p, "position");
        let mut sup = Supports::default();
        sup.prescribed.push((0, std::sync::Arc::new(Vector3::new(p[0], p[1], p[2]))));
        sup.prescribed.push((n, std::sync::Arc::new(Vector3::new(q[0], q[1], q[2]))));
        let loads = Loads { gravity: Vector3::new(g[0], g[1], g[2]), ..Default::default() };
        match rest(&rod, &sup, &loads, 0.0, &Search::default()) {
            Ok(f) => {
                iters.push(f.iterations);
                let csv = std::fs::read_to_string(format!("{dir}/c{c:02}.csv")).unwrap();
                let mut d = 0.0f64;
                for (row, l) in csv.lines().skip(1).enumerate() {
                    let a: Vec<f64> = l.split(',').map(|x| x.parse().unwrap()).collect();
                    let s = a[0] / length * n as f64;
                    if (s - s.round()).abs() > 1e-9 {
                        println!("c{c} row {row} off vertex {s}");
                    }
                    let x = f.rest.vertices[s.round() as usize];
                    d = d.max((x - Vector3::new(a[1], 0.0, a[2])).norm());
                }
                worst = worst.max(d);
                if d <= 2e-3 { ok += 1 } else { println!("c{c:02} off by {d:.2e} it {}", f.iterations) }
            }
            Err(e) => println!("c{c:02} {e}"),
        }
    }
    iters.sort();
    println!(
        "cables: {ok} of 56, worst {worst:.2e} m, iterations {:?} .. {:?}, {:.2} s",
        iters.first(),
        iters.last(),
        t0.elapsed().as_secs_f64()
    );
}
fn fixtures() {
    let dir = "/work/shared/fixtures/statics";
    let mut files: Vec<_> = std::fs::read_dir(dir)
        .unwrap()
        .map(|f| f.unwrap().path())
        .filter(|p| p.extension().is_some_and(|e| e == "json"))
        .collect();
    files.sort();
    for p in files {
        let j: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(&p).unwrap()).unwrap();
        let f = |k: &str| j[k].as_f64().unwrap();
        let mut line = format!("{:<40}", j["name"].as_str().unwrap());
        let mut errors = vec![];
        for n in [40usize, 80, 160] {
            // half edges at clamped ends: the face of the reference at the middle of a held edge twice as long as its own half
            let l = f("length");
            let cs = j["start"]["kind"] == "clamp";
            let ce = j["end"]["kind"] == "clamp";
            let k = n as f64 - 0.5 * (cs as u8 as f64) - 0.5 * (ce as u8 as f64);
            let h = l / k;
            let (ei, gj) = (f("ei"), f("gj"));
            let mut rod =
                Rod::uniform(h * n as f64, n, &section(f("ea"), ei, gj, f("mass_per_length"))).unwrap();
            let half = f("mass_per_length") * h / 2.0;
            // inside vertex carries nothing, the outside one the whole of 0..h... : half edge outside + half of the face's piece
            if cs {
                rod.masses[0] = 1e-12 * half;
                rod.masses[1] = 2.0 * half;
            }
            if ce {
                rod.masses[n] = 1e-12 * half;
                rod.masses[n - 1] = 2.0 * half;
            }
            let nc = &j["natural_curvature"];
            rod = rod.naturally([nc[0].as_f64().unwrap(), nc[1].as_f64().unwrap()], 0.0);
            let mut sup = Supports::default();
            let st = &j["start"];
            if cs {
                sup.start = Some(Clamp::new(
                    v3(&st["position"]) - v3(&st["tangent"]).normalize() * h / 2.0,
                    v3(&st["tangent"]),
                    v3(&st["director"]),
                ));
            } else {
                sup.prescribed.push((0, std::sync::Arc::new(v3(&st["position"]))));
            }
            let en = &j["end"];
            let mut loads = Loads { gravity: v3(&j["gravity"]), ..Default::default() };
            if ce {
                sup.end = Some(Clamp::new(
                    v3(&en["position"]) + v3(&en["tangent"]).normalize() * h / 2.0,
                    v3(&en["tangent"]),
                    v3(&en["director"]),
                ));
            } else if en["kind"] == "pin" {
                sup.prescribed.push((n, std::sync::Arc::new(v3(&en["position"]))));
            } else if en["force"].is_array() {
                loads.point_forces.push((rod.length(), std::sync::Arc::new(v3(&en["force"]))));
            }
            let search = Search { end_turn: en["turn_rad"].as_f64().unwrap_or(0.0), ..Default::default() };
            let t0 = Instant::now();
            match rest(&rod, &sup, &loads, 0.0, &search) {
                Ok(found) => {
                    let off = if cs { h / 2.0 } else { 0.0 };
                    let dist = |turn: f64| {
                        let q = nalgebra::Rotation3::from_axis_angle(&Vector3::x_axis(), turn);
                        let mut worst = 0.0f64;
                        for (s, r) in j["s"].as_array().unwrap().iter().zip(j["r"].as_array().unwrap()) {
                            let u = (s.as_f64().unwrap() + off) / h;
                            let i = (u.floor() as usize).clamp(1, n - 2);
                            let w = u - i as f64;
                            let x = &found.rest.vertices;
                            let p = x[i - 1] * (-w * (w - 1.0) * (w - 2.0) / 6.0)
                                + x[i] * ((w + 1.0) * (w - 1.0) * (w - 2.0) / 2.0)
                                + x[i + 1] * (-(w + 1.0) * w * (w - 2.0) / 2.0)
                                + x[i + 2] * ((w + 1.0) * w * (w - 1.0) / 6.0);
                            worst = worst.max((q * p - v3(r)).norm());
                        }
                        worst / l
                    };
                    let free_plane = cs && ce && v3(&j["gravity"]).norm() == 0.0;
                    let e = if free_plane {
                        let m = found.rest.vertices[n / 2];
                        let r = v3(&j["r"][10]);
                        dist(r.z.atan2(r.y) - m.z.atan2(m.y))
                    } else {
                        dist(0.0)
                    };
                    errors.push(e);
                    line += &format!(
                        " {e:9.2e} it {:4} in {:3} {:.3}s",
                        found.iterations,
                        found.solves,
                        t0.elapsed().as_secs_f64()
                    );
                }
                Err(e) => line += &format!("  FAILED {e}"),
            }
        }
        if errors.len() == 3 {
            line += &format!("  order {:.2}", (errors[1] / errors[2]).log2());
        }
        println!("{line}");
    }
}
fn grid(full: bool) {
    let dirs = [
        ("aligned", Vector3::new(1.0, 0.0, 0.0), Vector3::new(1.0, 0.0, 0.0)),
        ("up-up", Vector3::new(0.0, 0.0, 1.0), Vector3::new(0.0, 0.0, 1.0)),
        ("arch", Vector3::new(0.5, 0.0, 0.87), Vector3::new(0.5, 0.0, -0.87)),
        ("out-in", Vector3::new(0.3, 0.9, 0.1), Vector3::new(0.3, -0.9, 0.2)),
        ("reversed", Vector3::new(-1.0, 0.0, 0.0), Vector3::new(-1.0, 0.0, 0.0)),
        ("facing", Vector3::new(0.0, 1.0, 0.0), Vector3::new(0.0, 0.0, 1.0)),
        ("pins", Vector3::zeros(), Vector3::zeros()),
    ];
    let (mut ok, mut all, mut total_it, t0) = (0, 0, 0usize, Instant::now());
    let segs: &[usize] = if full { &[20, 50, 100, 400] } else { &[20, 100] };
    for (name, ta, tb) in dirs {
        if std::env::var("GRID").is_ok_and(|only| !only.split(",").any(|o| o == name)) { continue; }
        let (mut good, mut of, mut most, mut slow) = (0, 0, 0, 0.0f64);
        for &n in segs {
            for ei in [0.0f64, 1e-6, 1e-4, 1e-2, 1.0] {
                for d in [0.05f64, 0.15, 0.3, 0.5, 0.8, 0.95, 1.0, 1.05] {
                    for level in [0.0, 0.5] {
                        for g in [0.0, 9.81] {
                            // a chain without weight has no shape of its own when slack
                            if ei == 0.0 && g == 0.0 {
                                continue;
                            }
                            let ea = (1e6 * ei).max(1e3);
                            let rod = Rod::uniform(1.0, n, &section(ea, ei, 0.7 * ei, 0.05)).unwrap();
                            let far = Vector3::new(d * f64::cos(level), 0.0, d * f64::sin(level));
                            let mut sup = Supports::default();
                            let dir = |t: Vector3<f64>| t.cross(&Vector3::new(0.1, -0.3, 0.7)).normalize();
                            if name == "pins" {
                                sup.prescribed.push((0, std::sync::Arc::new(Vector3::zeros())));
                                sup.prescribed.push((n, std::sync::Arc::new(far)));
                            } else {
                                sup.start = Some(Clamp::new(Vector3::zeros(), ta, dir(ta)));
                                sup.end = Some(Clamp::new(far, tb, dir(tb)));
                            }
                            let loads = Loads { gravity: Vector3::new(0.0, 0.0, -g), ..Default::default() };
                            let t1 = Instant::now();
                            of += 1;
                            match rest(&rod, &sup, &loads, 0.0, &Search::default()) {
                                Ok(f) => {
                                    good += 1;
                                    most = most.max(f.iterations);
                                    total_it += f.iterations;
                                }
                                Err(e) => println!(
                                    "{name} n {n} ei {ei} d {d} level {level} g {g}: {:.2}s {e}",
                                    t1.elapsed().as_secs_f64()
                                ),
                            }
                            slow = slow.max(t1.elapsed().as_secs_f64());
                        }
                    }
                }
            }
        }
        println!("{name}: {good} of {of}, most iterations {most}, slowest {slow:.2} s");
        ok += good;
        all += of;
    }
    println!("grid: {ok} of {all}, {total_it} iterations, {:.1} s", t0.elapsed().as_secs_f64());
}
fn main() {
    let a: Vec<String> = std::env::args().collect();
    match a.get(1).map(String::as_str) {
        Some("cables") => cables(),
        Some("fixtures") => fixtures(),
        Some("grid") => grid(false),
        Some("full") => grid(true),
        Some("one") => {
            let f = |i: usize| a[i].parse::<f64>().unwrap();
            let (n, ei, d, level, g) = (f(2) as usize, f(3), f(4), f(5), f(6));
            let ea = (1e6 * ei).max(1e3);
            let rod = Rod::uniform(1.0, n, &section(ea, ei, 0.7 * ei, 0.05)).unwrap();
            let far = Vector3::new(d * f64::cos(level), 0.0, d * f64::sin(level));
            let ta = match a.get(7).map(String::as_str) {
                Some("up") => Vector3::z(),
                Some("rev") => -Vector3::x(),
                _ => Vector3::x(),
            };
            let dir = |t: Vector3<f64>| t.cross(&Vector3::new(0.1, -0.3, 0.7)).normalize();
            let sup = Supports {
                start: Some(Clamp::new(Vector3::zeros(), ta, dir(ta))),
                end: Some(Clamp::new(far, ta, dir(ta))),
                ..Default::default()
            };
            let loads = Loads { gravity: Vector3::new(0.0, 0.0, -g), ..Default::default() };
            println!(
                "{:?}",
                rest(&rod, &sup, &loads, 0.0, &Search::default()).map(|f| (
                    f.energy,
                    f.iterations,
                    f.neutral
                ))
            );
        }
        _ => {
            cables();
            fixtures();
        }
    }
}
