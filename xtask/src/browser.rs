//! Pages in a headless browser: they are served on a port of this machine; a page of ours, the harness, opens
//! each in a frame, looks, and sends back what it found. No other program is needed than the browser.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Names under which the browser may be installed.
const NAMES: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "chrome"];

/// The longest that all pages may take.
const PATIENCE: Duration = Duration::from_secs(240);

/// What the harness sends back of the pages of a folder: a line for each fault, and a last line with what was
/// looked at. Without a browser nothing, and a word about it.
///
/// The harness is a script that finds the names of the pages in `pages`.
pub(crate) fn look(site: &Path, pages: &[String], harness: &str) -> Result<Option<Report>, String> {
    let listener = TcpListener::bind("127.0.0.1:0").map_err(|e| format!("no port to serve pages on: {e}"))?;
    let port = listener.local_addr().map_err(|e| e.to_string())?.port();
    let profile = std::env::temp_dir().join(format!("varda-pages-{}", std::process::id()));
    let Some(mut browser) = start(&format!("http://127.0.0.1:{port}/check"), &profile)? else {
        println!(
            "skipped: no browser ({}) is installed, rendered pages were not looked at",
            NAMES.join(", ")
        );
        return Ok(None);
    };
    let result = serve(&listener, site, &page_of(pages, harness));
    let _ = browser.kill();
    let _ = browser.wait();
    let _ = std::fs::remove_dir_all(&profile);
    let mut faults: Vec<String> = result?.lines().map(str::to_string).collect();
    let seen = faults.pop().unwrap_or_default();
    println!("browser: {seen}");
    let counts = seen.split([' ', ',']).filter_map(|word| word.parse().ok()).collect();
    Ok(Some(Report { faults, seen, counts }))
}

/// What a harness found.
pub(crate) struct Report {
    pub(crate) faults: Vec<String>,
    /// What was looked at, in words: a harness that saw nothing cannot pass.
    pub(crate) seen: String,
    /// The numbers in it.
    pub(crate) counts: Vec<usize>,
}

/// The browser on a page, or none.
fn start(page: &str, profile: &Path) -> Result<Option<Child>, String> {
    for name in NAMES {
        let mut command = Command::new(name);
        command.args([
            "--headless",
            "--no-sandbox",
            "--use-angle=swiftshader",
            "--disable-quic",
            "--no-first-run",
        ]);
        command.args(["--disable-background-networking", "--disable-component-update", "--disable-sync"]);
        command.arg("--enable-unsafe-swiftshader");
        command.args(["--remote-debugging-port=0", "--window-size=1600,1000"]);
        command.arg(format!("--user-data-dir={}", profile.display())).arg(page);
        match command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn() {
            Ok(child) => return Ok(Some(child)),
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => {}
            Err(e) => return Err(format!("{name}: {e}")),
        }
    }
    Ok(None)
}

/// Serves files until the harness has sent its report.
fn serve(listener: &TcpListener, site: &Path, harness: &str) -> Result<String, String> {
    listener.set_nonblocking(true).map_err(|e| e.to_string())?;
    let end = Instant::now() + PATIENCE;
    while Instant::now() < end {
        match listener.accept() {
            Ok((stream, _)) => {
                let _ = stream.set_nonblocking(false);
                let _ = stream.set_read_timeout(Some(Duration::from_secs(5)));
                // After a broken connection the browser asks again, or the report never comes.
                if let Ok(Some(report)) = answer(stream, site, harness) {
                    return Ok(report);
                }
            }
            Err(_) => std::thread::sleep(Duration::from_millis(2)),
        }
    }
    Err(format!("the browser has sent no report within {} s", PATIENCE.as_secs()))
}

/// Answers one request; the report, if it was that.
fn answer(mut stream: TcpStream, site: &Path, harness: &str) -> std::io::Result<Option<String>> {
    let mut reader = BufReader::new(stream.try_clone()?);
    let mut request = String::new();
    reader.read_line(&mut request)?;
    let mut length = 0;
    loop {
        let mut line = String::new();
        if reader.read_line(&mut line)? == 0 || line.trim().is_empty() {
            break;
        }
        if let Some(value) = line.to_ascii_lowercase().strip_prefix("content-length:") {
            length = value.trim().parse().unwrap_or(0);
        }
    }
    let path = request.split(' ').nth(1).unwrap_or("/").split(['?', '#']).next().unwrap_or("/");
    let (kind, body) = match path {
        "/report" => {
            let mut body = vec![0; length];
            reader.read_exact(&mut body)?;
            send(&mut stream, "200 OK", "text/plain", b"")?;
            return Ok(Some(String::from_utf8_lossy(&body).into_owned()));
        }
        "/check" => ("text/html", harness.as_bytes().to_vec()),
        path => {
            let file = crate::docs::html::normal(Path::new(path.trim_start_matches('/')));
            let kind = match file.extension().and_then(|e| e.to_str()) {
                Some("html") => "text/html; charset=utf-8",
                Some("css") => "text/css",
                Some("js") => "text/javascript",
                Some("svg") => "image/svg+xml",
                Some("woff2") => "font/woff2",
                _ => "application/octet-stream",
            };
            match std::fs::read(site.join(&file)) {
                Ok(body) => (kind, body),
                Err(_) => {
                    send(&mut stream, "404 Not Found", "text/plain", b"")?;
                    return Ok(None);
                }
            }
        }
    };
    send(&mut stream, "200 OK", kind, &body)?;
    Ok(None)
}

fn send(stream: &mut TcpStream, status: &str, kind: &str, body: &[u8]) -> std::io::Result<()> {
    let length = body.len();
    let head = format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {length}\r\nConnection: close\r\n\r\n"
    );
    stream.write_all(head.as_bytes())?;
    stream.write_all(body)
}

/// The page that looks at pages.
fn page_of(pages: &[String], harness: &str) -> String {
    let list: Vec<String> = pages.iter().map(|page| format!("\"{page}\"")).collect();
    format!(
        "<!DOCTYPE html><meta charset=\"utf-8\"><script>const pages = [{}];{harness}</script>",
        list.join(",")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_served_and_a_report_ends_it() {
        let site = std::env::temp_dir().join(format!("varda-serve-{}", std::process::id()));
        std::fs::create_dir_all(&site).unwrap();
        std::fs::write(site.join("a.html"), "text").unwrap();
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let ask = move |text: &str| {
            let mut stream = TcpStream::connect(("127.0.0.1", port)).unwrap();
            stream.write_all(text.as_bytes()).unwrap();
            let mut answer = String::new();
            stream.read_to_string(&mut answer).unwrap();
            answer
        };
        let reader = std::thread::spawn(move || {
            let found = ask("GET /a.html HTTP/1.1\r\n\r\n");
            let missing = ask("GET /../b.html HTTP/1.1\r\n\r\n");
            ask("POST /report HTTP/1.1\r\nContent-Length: 4\r\n\r\ndone");
            (found, missing)
        });
        assert_eq!(serve(&listener, &site, "").as_deref(), Ok("done"));
        let (found, missing) = reader.join().unwrap();
        assert!(found.ends_with("text"), "{found}");
        assert!(missing.starts_with("HTTP/1.1 404"), "{missing}");
        std::fs::remove_dir_all(&site).unwrap();
    }
}
