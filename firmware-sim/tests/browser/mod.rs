//! A page in Chromium, and what a script finds in it.

use std::io::{Read, Write};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

/// Opens `page` and gives what the body of an asynchronous function, `script`, returns. It may use `wait(ms)` and `painted()`, which is over
/// when the page has been painted. Fails when the page or the script report an error.
pub fn run(page: &Path, script: &str) -> Value {
    let browser = ["chromium", "chromium-browser", "google-chrome"]
        .into_iter()
        .find(|name| Command::new(name).arg("--version").output().is_ok_and(|o| o.status.success()));
    let Some(browser) = browser else {
        panic!("the viewer tests need Chromium; install it with: apt-get install -y chromium");
    };
    let listener = TcpListener::bind(("127.0.0.1", 0)).expect("a local port");
    let checked = instrumented(page, script, listener.local_addr().expect("its address").port());
    let mut running = Command::new(browser)
        .args(["--headless=new", "--no-sandbox", "--disable-gpu", "--window-size=1280,800"])
        .arg("--remote-debugging-port=0")
        .arg(format!("--user-data-dir={}", page.with_file_name("profile").display()))
        .arg(format!("file://{}", checked.display()))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("the browser starts");
    let report = reported(&listener);
    let _ = running.kill();
    let _ = running.wait();
    let report = report.expect("the page reports within a minute");
    let mut report: Value = serde_json::from_str(&report).expect("the report is JSON");
    assert_eq!(report["problems"], Value::Array(Vec::new()), "{report}");
    report["result"].take()
}

/// The page with a recorder of errors before its own scripts, and behind them `script`, whose result goes to `port`.
fn instrumented(page: &Path, script: &str, port: u16) -> PathBuf {
    let text = std::fs::read_to_string(page).expect("the page");
    let recorder = "<head><script>window.problems = [];\
        addEventListener('error', (e) => problems.push(String(e.message)));\
        addEventListener('unhandledrejection', (e) => problems.push(String(e.reason)));\
        console.error = (...a) => problems.push(a.join(' '));</script>";
    let check = format!(
        "<script>(async () => {{\
        const wait = (ms) => new Promise((done) => setTimeout(done, ms));\
        const painted = () => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));\
        let result = null;\
        try {{ result = await (async () => {{\n{script}\n}})(); }} catch (e) {{ problems.push(String(e.stack)); }}\
        fetch('http://127.0.0.1:{port}/', {{ method: 'POST', mode: 'no-cors', body: JSON.stringify({{ problems, result }}) }});\
        }})();</script></body>"
    );
    let text = text.replacen("<head>", recorder, 1).replacen("</body>", &check, 1);
    let copy = page.with_file_name("checked.html");
    std::fs::write(&copy, text).expect("a copy of the page");
    copy
}

/// The body of the first request that arrives within a minute.
fn reported(listener: &TcpListener) -> Option<String> {
    listener.set_nonblocking(true).expect("a listener that does not block");
    let deadline = Instant::now() + Duration::from_secs(60);
    while Instant::now() < deadline {
        let Ok((mut stream, _)) = listener.accept() else {
            std::thread::sleep(Duration::from_millis(50));
            continue;
        };
        stream.set_nonblocking(false).expect("a stream that blocks");
        stream.set_read_timeout(Some(Duration::from_secs(5))).expect("a time limit");
        let (mut received, mut part) = (Vec::new(), [0u8; 4096]);
        // The report is one JSON object; the request is over when it is complete.
        while let Ok(count) = stream.read(&mut part)
            && count > 0
        {
            received.extend(&part[..count]);
            let text = String::from_utf8_lossy(&received);
            if let Some((_, body)) = text.split_once("\r\n\r\n")
                && serde_json::from_str::<Value>(body).is_ok()
            {
                let _ = stream.write_all(b"HTTP/1.1 204 No Content\r\nContent-Length: 0\r\n\r\n");
                return Some(body.to_owned());
            }
        }
    }
    None
}
