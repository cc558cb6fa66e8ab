//! Several processes on one run.

use crate::common;

/// As the launcher of OpenMPI starts the first of three.
#[test]
#[cfg(not(feature = "mpi"))]
fn a_build_without_mpi_refuses_to_be_one_of_several() {
    let (dir, photos, run_dir) = common::noise_run(1);
    let output = common::rilievo()
        .args([
            "reconstruct",
            common::arg(&photos),
            "-o",
            common::arg(&run_dir),
        ])
        .envs([("OMPI_COMM_WORLD_SIZE", "3"), ("OMPI_COMM_WORLD_RANK", "0")])
        .output()
        .expect("the program starts");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(
        stderr.contains("--features mpi") && stderr.contains("OMPI_COMM_WORLD_SIZE"),
        "{stderr}"
    );
    assert!(!run_dir.exists());
    // A batch script of Slurm is one process, whatever its job has.
    let alone = common::rilievo()
        .args(["check", common::arg(&photos)])
        .envs([
            ("SLURM_JOB_ID", "1"),
            ("SLURM_NTASKS", "8"),
            ("SLURM_PROCID", "0"),
        ])
        .output()
        .expect("the program starts");
    assert_ne!(alone.status.code(), Some(2));
    drop(dir);
}

#[cfg(feature = "mpi")]
mod together {
    use super::common::{SmallDisk, arg, differences, json_of, noise_run, small_arguments};
    use rilievo_scene::StageId;
    use std::path::{Path, PathBuf};
    use std::process::{Command, Output, Stdio};
    use std::time::{Duration, Instant};

    const RILIEVO: &str = env!("CARGO_BIN_EXE_rilievo");

    /// The launcher of OpenMPI; `None`, with a word about it, where it is not installed.
    fn mpirun() -> Option<Command> {
        if Command::new("mpirun").arg("--version").output().is_err() {
            println!("left out: mpirun is not installed (.ci/setup mpi)");
            return None;
        }
        let mut command = Command::new("mpirun");
        command.args(["--oversubscribe", "--bind-to", "none"]);
        command.envs([
            ("OMPI_ALLOW_RUN_AS_ROOT", "1"),
            ("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1"),
        ]);
        Some(command)
    }

    /// Runs the program on so many ranks.
    fn on_ranks(num: usize, arguments: &[String]) -> Option<Output> {
        let mut command = mpirun()?;
        command.args(["-n", &num.to_string(), RILIEVO]);
        command.args(arguments);
        Some(command.output().expect("the launcher starts"))
    }

    #[track_caller]
    fn ended_with(output: &Output, code: i32) -> String {
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{stderr}");
        stderr
    }

    fn until(stage: &str, mut arguments: Vec<String>) -> Vec<String> {
        arguments.extend(["--until".to_owned(), stage.to_owned()]);
        arguments
    }

    /// The small set reconstructed by one process, up to a stage.
    fn by_one(run: &Path, stage: &str) {
        let arguments = until(stage, small_arguments(run));
        let output = Command::new(RILIEVO).args(&arguments).output();
        ended_with(&output.expect("the program starts"), 0);
    }

    #[test]
    fn any_number_of_ranks_and_threads_gives_the_same_bytes() {
        let dir = tempfile::tempdir().unwrap();
        let alone = dir.path().join("alone");
        by_one(&alone, "6_fusion");
        for (num, threads) in [(1, "2"), (2, "1"), (4, "2")] {
            let run = dir.path().join(format!("ranks-{num}"));
            let mut arguments = until("6_fusion", small_arguments(&run));
            arguments.extend(["--threads".to_owned(), threads.to_owned()]);
            let Some(output) = on_ranks(num, &arguments) else {
                return;
            };
            let stderr = ended_with(&output, 0);
            assert_eq!(
                differences(&alone, &run),
                Vec::<String>::new(),
                "{num} ranks"
            );
            // One rank speaks for all.
            assert_eq!(stderr.matches("1_photos: starting").count(), 1, "{stderr}");
            assert!(!run.join(".work").exists());
            let of = |run: &PathBuf, stage: &str, key: &str| {
                json_of(&run.join(stage).join("manifest.json"))[key].clone()
            };
            for stage in StageId::ALL.map(StageId::name) {
                for key in ["items", "files", "warnings", "fingerprint"] {
                    let [one, several] = [&alone, &run].map(|run| of(run, stage, key));
                    assert_eq!(one, several, "{num} ranks, {stage} {key}");
                }
            }
            // Later reports tell times.
            for stage in ["1_photos", "2_features", "3_poses"] {
                let [one, several] = [&alone, &run].map(|run| of(run, stage, "report"));
                assert_eq!(one, several, "{num} ranks, {stage}");
            }
        }
    }

    #[test]
    fn a_killed_rank_ends_all_and_the_same_command_goes_on_to_the_same_bytes() {
        let Some(mut command) = mpirun() else { return };
        let dir = tempfile::tempdir().unwrap();
        let (alone, run) = (dir.path().join("alone"), dir.path().join("ranks"));
        by_one(&alone, "6_fusion");
        let arguments = small_arguments(&run);
        command.args(["-n", "3", RILIEVO]).args(&arguments);
        let command = command.stdout(Stdio::null()).stderr(Stdio::null());
        let mut launcher = command.spawn().expect("the launcher starts");
        let begun = Instant::now();
        while !run.join("2_features/manifest.json").exists() {
            assert!(begun.elapsed() < Duration::from_secs(300));
            std::thread::sleep(Duration::from_millis(20));
        }
        let ranks = children(launcher.id());
        assert_eq!(ranks.len(), 3);
        let killed = Command::new("kill").args(["-9", &ranks[1]]).status();
        assert!(killed.is_ok_and(|status| status.success()));
        let begun = Instant::now();
        let status = launcher.wait().expect("the launcher ends");
        assert!(!status.success());
        while ranks.iter().any(|rank| is_running(rank)) {
            std::thread::sleep(Duration::from_millis(20));
        }
        let time = begun.elapsed();
        assert!(time < Duration::from_secs(10), "{time:?}");
        let output = on_ranks(3, &arguments).expect("the launcher is there");
        let stderr = ended_with(&output, 0);
        assert!(stderr.contains("1_photos: kept"), "{stderr}");
        assert_eq!(differences(&alone, &run), Vec::<String>::new());
    }

    fn children(process: u32) -> Vec<String> {
        let list = format!("/proc/{process}/task/{process}/children");
        let list = std::fs::read_to_string(list).expect("the system tells of children");
        let is_rank = |child: &&str| {
            let name = std::fs::read_to_string(format!("/proc/{child}/comm"));
            name.is_ok_and(|name| name.trim() == "rilievo")
        };
        let ranks = list.split_whitespace().filter(is_rank);
        ranks.map(str::to_owned).collect()
    }

    fn is_running(process: &str) -> bool {
        let status = std::fs::read_to_string(format!("/proc/{process}/status"));
        status.is_ok_and(|status| status.contains("rilievo") && !status.contains("Z (zombie)"))
    }

    #[test]
    fn ranks_that_were_asked_for_different_things_are_told_both() {
        let Some(mut command) = mpirun() else { return };
        let (dir, photos, run) = noise_run(2);
        let config = dir.path().join("options.toml");
        std::fs::write(&config, "[shading.paper]\nnoise = 0.02\n").unwrap();
        let asked = ["reconstruct", arg(&photos), "-o", arg(&run)];
        command.args(["-n", "1", RILIEVO]).args(asked);
        command.args([":", "-n", "1", RILIEVO]).args(asked);
        let output = command.args(["--config", arg(&config)]).output();
        let stderr = ended_with(&output.unwrap(), 2);
        let told = "request.options.shading.paper.noise is 0.01 for rank 0 and 0.02 for rank 1";
        assert!(stderr.contains(told), "{stderr}");
        assert!(!run.exists());
    }

    /// A shell that makes a folder the second rank's own, and then runs the program; `None` where this process may
    /// not.
    fn with_another_folder(folder: &Path, then: &str) -> Option<Command> {
        let may = Command::new("unshare").args(["-m", "true"]).status();
        if !may.is_ok_and(|status| status.success()) {
            println!("left out: no right to mount");
            return None;
        }
        let mut command = mpirun()?;
        let script = format!(
            "[ $OMPI_COMM_WORLD_RANK = 0 ] || {{ mount -t tmpfs tmpfs {} && {then}; }}; exec \"$@\"",
            arg(folder)
        );
        command.args([
            "-n", "2", "unshare", "-m", "sh", "-c", &script, "sh", RILIEVO,
        ]);
        Some(command)
    }

    #[test]
    fn a_rank_that_sees_another_run_directory_is_told() {
        let (dir, photos, _) = noise_run(1);
        let shared = dir.path().join("shared");
        std::fs::create_dir(&shared).unwrap();
        let Some(mut command) = with_another_folder(&shared, "true") else {
            return;
        };
        let run = shared.join("run");
        let output = command
            .args(["reconstruct", arg(&photos), "-o", arg(&run)])
            .output();
        let stderr = ended_with(&output.unwrap(), 5);
        assert!(
            stderr.contains("rank 1 on ") && stderr.contains("here it is none"),
            "{stderr}"
        );
    }

    #[test]
    fn a_rank_without_a_photo_names_its_host_and_the_file() {
        let (dir, photos, run) = noise_run(2);
        let copy = dir.path().join("copy.jpg");
        std::fs::copy(photos.join("p0.jpg"), &copy).unwrap();
        let then = format!("cp {} {}", arg(&copy), arg(&photos.join("p0.jpg")));
        let Some(mut command) = with_another_folder(&photos, &then) else {
            return;
        };
        let output = command
            .args(["reconstruct", arg(&photos), "-o", arg(&run)])
            .output();
        let stderr = ended_with(&output.unwrap(), 3);
        assert!(
            stderr.contains("p1.jpg: rank 1 on ") && !stderr.contains("p0.jpg:"),
            "{stderr}"
        );
    }

    #[test]
    fn a_full_disk_ends_all_ranks_in_time() {
        let Some(disk) = SmallDisk::new(600) else {
            println!("left out: no right to mount");
            return;
        };
        let (_dir, photos, _) = noise_run(12);
        let run = disk.path.join("run");
        let asked = ["reconstruct", arg(&photos), "-o", arg(&run)].map(str::to_owned);
        let begun = Instant::now();
        let Some(output) = on_ranks(3, &asked) else {
            return;
        };
        let stderr = ended_with(&output, 6);
        assert!(begun.elapsed() < Duration::from_secs(20));
        assert!(stderr.contains(arg(&run)), "{stderr}");
        disk.grow(60_000);
        let mut asked = asked.to_vec();
        asked = until("2_features", asked);
        ended_with(&on_ranks(3, &asked).unwrap(), 0);
    }

    #[test]
    fn commands_that_divide_nothing_are_refused() {
        let Some(output) = on_ranks(2, &["check".to_owned(), "nowhere".to_owned()]) else {
            return;
        };
        let stderr = ended_with(&output, 2);
        assert!(stderr.contains("without the launcher"), "{stderr}");
    }
}
