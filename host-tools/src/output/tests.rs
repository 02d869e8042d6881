use super::*;

fn entries(folder: &Path) -> usize {
    fs::read_dir(folder).unwrap().count()
}

#[test]
fn writes_the_whole_file_and_makes_folders() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a/b/out.bin");
    write_atomic(&path, |w| w.write_all(b"whole")).unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"whole");
    assert_eq!(entries(path.parent().unwrap()), 1);
}

#[test]
fn a_failing_writer_leaves_the_old_file_and_no_rest() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.bin");
    fs::write(&path, b"old").unwrap();
    let error = write_atomic(&path, |w| {
        w.write_all(b"half")?;
        Err(io::Error::other("disk gone"))
    })
    .unwrap_err();
    assert!(matches!(error, Error::Write { .. }), "{error}");
    assert_eq!(fs::read(&path).unwrap(), b"old");
    assert_eq!(entries(folder.path()), 1);
}

#[test]
fn a_folder_or_a_file_in_the_way_is_a_typed_error() {
    let folder = tempfile::tempdir().unwrap();
    assert!(matches!(write_atomic(folder.path(), |_| Ok(())), Err(Error::NotAFile { .. })));
    let file = folder.path().join("file");
    fs::write(&file, b"x").unwrap();
    assert!(matches!(write_atomic(file.join("below"), |_| Ok(())), Err(Error::Folder { .. })));
    assert_eq!(entries(folder.path()), 1);
}

#[test]
fn what_a_killed_run_left_is_removed_and_what_a_running_one_writes_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let abandoned = folder.path().join(".motionette-AbCdEf.tmp");
    fs::write(&abandoned, b"half").unwrap();
    let others =
        [".motionette.tmp", ".other-AbCdEf.tmp", ".motionette-AbCdEf.blob"].map(|name| folder.path().join(name));
    others.iter().for_each(|path| fs::write(path, b"not ours").unwrap());
    let (first, second) = (folder.path().join("first"), folder.path().join("second"));
    write_atomic(&first, |w| {
        w.write_all(b"1")?;
        // Another file is written into the folder meanwhile, by a run that looks round as well.
        write_atomic(&second, |w| w.write_all(b"2")).map_err(io::Error::other)
    })
    .unwrap();
    assert!(!abandoned.exists());
    assert_eq!([fs::read(first).unwrap(), fs::read(second).unwrap()], [b"1", b"2"]);
    assert!(others.iter().all(|path| path.exists()));
    assert_eq!(entries(folder.path()), 5);
}

#[test]
fn many_writers_of_one_folder_do_not_take_each_others_files() {
    let folder = tempfile::tempdir().unwrap();
    std::thread::scope(|scope| {
        for writer in 0..8_u8 {
            let folder = folder.path();
            scope.spawn(move || {
                for round in 0..20_u8 {
                    let path = folder.join(format!("{writer}-{round}"));
                    write_atomic(&path, |w| w.write_all(&[writer, round])).unwrap();
                    assert_eq!(fs::read(&path).unwrap(), [writer, round]);
                }
            });
        }
    });
    assert_eq!(entries(folder.path()), 160);
}

#[cfg(unix)]
mod unix {
    use std::os::unix::fs::{FileTypeExt, PermissionsExt, symlink};
    use std::os::unix::net::UnixListener;
    use std::process::Command;

    use super::*;

    fn mode(path: &Path) -> u32 {
        fs::metadata(path).unwrap().permissions().mode() & 0o7777
    }

    #[test]
    fn links_stay_links_and_lead_to_what_was_written() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::create_dir(at("below")).unwrap();
        fs::write(at("below/file"), b"old").unwrap();
        symlink("below/file", at("direct")).unwrap();
        symlink(at("direct"), at("below/twice")).unwrap();
        symlink("below/new", at("nowhere")).unwrap();
        for (link, file) in [("direct", "below/file"), ("below/twice", "below/file"), ("nowhere", "below/new")] {
            write_atomic(at(link), |w| w.write_all(link.as_bytes())).unwrap();
            assert!(fs::symlink_metadata(at(link)).unwrap().is_symlink(), "{link}");
            assert_eq!(fs::read(at(file)).unwrap(), link.as_bytes(), "{link}");
        }
        symlink("round", at("round")).unwrap();
        assert!(matches!(write_atomic(at("round"), |_| Ok(())), Err(Error::Write { .. })));
        assert!(fs::symlink_metadata(at("round")).unwrap().is_symlink());
    }

    #[test]
    fn a_file_keeps_its_mode_and_a_read_only_one_its_content() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        for kept in [0o600, 0o640, 0o755, 0o664] {
            fs::write(&path, b"old").unwrap();
            fs::set_permissions(&path, fs::Permissions::from_mode(kept)).unwrap();
            write_atomic(&path, |w| w.write_all(b"new")).unwrap();
            assert_eq!((mode(&path), fs::read(&path).unwrap()), (kept, b"new".to_vec()));
        }
        fs::set_permissions(&path, fs::Permissions::from_mode(0o400)).unwrap();
        assert!(matches!(write_atomic(&path, |w| w.write_all(b"newer")), Err(Error::ReadOnly { .. })));
        assert_eq!((mode(&path), fs::read(&path).unwrap()), (0o400, b"new".to_vec()));
    }

    #[test]
    fn pipes_are_written_to_and_sockets_refused() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let reader = std::thread::spawn({
            let pipe = pipe.clone();
            move || fs::read(pipe).unwrap()
        });
        write_atomic(&pipe, |w| w.write_all(b"through")).unwrap();
        assert_eq!(reader.join().unwrap(), b"through");
        assert!(fs::metadata(&pipe).unwrap().file_type().is_fifo());
        let socket = folder.path().join("socket");
        let _listener = UnixListener::bind(&socket).unwrap();
        assert!(matches!(write_atomic(&socket, |_| Ok(())), Err(Error::Special { what: "socket", .. })));
        assert_eq!(entries(folder.path()), 2);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_device_is_reported_and_stays_a_device() {
        let error = write_atomic("/dev/full", |w| w.write_all(b"bytes")).unwrap_err();
        assert!(
            matches!(&error, Error::Write { source, .. } if source.kind() == io::ErrorKind::StorageFull),
            "{error:?}"
        );
        write_atomic("/dev/null", |w| w.write_all(b"bytes")).unwrap();
        for device in ["/dev/full", "/dev/null"] {
            assert!(fs::symlink_metadata(device).unwrap().file_type().is_char_device(), "{device}");
        }
    }
}
