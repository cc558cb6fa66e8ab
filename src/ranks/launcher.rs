//! Whether a launcher started this process as one of several, by what it leaves in the environment.

/// How this process was started.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Launch {
    /// Processes in all, two or more.
    pub size: usize,
    /// The number of this one, where the launcher states it.
    pub rank: usize,
    /// The variable that holds the size.
    pub variable: &'static str,
}

/// Variables with the number of processes and the number of this one: of OpenMPI, of MPICH and its kin (which Slurm
/// sets too), and of a step of Slurm. `SLURM_NTASKS` would not do: a batch script of a job with several tasks has
/// it, though it is one process.
const VARIABLES: [[&str; 2]; 3] = [
    ["OMPI_COMM_WORLD_SIZE", "OMPI_COMM_WORLD_RANK"],
    ["PMI_SIZE", "PMI_RANK"],
    ["SLURM_STEP_NUM_TASKS", "SLURM_PROCID"],
];

impl Launch {
    /// What the environment says; `None` for a process on its own.
    pub fn found() -> Option<Self> {
        Self::of(|name| std::env::var(name).ok())
    }

    fn of(variable: impl Fn(&str) -> Option<String>) -> Option<Self> {
        let number = |name: &str| variable(name)?.trim().parse::<usize>().ok();
        // A batch script is no step of its own, but may have been submitted from one and have its variables.
        let is_batch_script =
            number("SLURM_STEP_ID").is_none() && variable("SLURM_JOB_ID").is_some();
        VARIABLES.iter().find_map(|&[size_in, rank_in]| {
            if size_in.starts_with("SLURM") && is_batch_script {
                return None;
            }
            let (size, rank) = (number(size_in)?, number(rank_in)?);
            (size > 1).then_some(Self {
                size,
                rank,
                variable: size_in,
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(variables: &[(&str, &str)]) -> Option<usize> {
        let find = |name: &str| {
            let found = variables.iter().find(|(known, _)| *known == name);
            found.map(|(_, value)| (*value).to_owned())
        };
        Launch::of(find).map(|launch| launch.size)
    }

    #[test]
    fn only_one_of_several_processes_is_launched() {
        assert_eq!(of(&[]), None);
        let open_mpi = |size| {
            [
                ("OMPI_COMM_WORLD_SIZE", size),
                ("OMPI_COMM_WORLD_RANK", "0"),
            ]
        };
        assert_eq!(of(&open_mpi("3")), Some(3));
        assert_eq!(of(&open_mpi("1")), None);
        assert_eq!(of(&[("PMI_RANK", "1"), ("PMI_SIZE", "2")]), Some(2));
        // A step of Slurm, a batch script of a job with several tasks, and a task of an array.
        let job = ("SLURM_JOB_ID", "7");
        let batch = [job, ("SLURM_NTASKS", "4"), ("SLURM_PROCID", "0")];
        assert_eq!(of(&batch), None);
        let step = ("SLURM_STEP_NUM_TASKS", "4");
        let in_step = [job, ("SLURM_STEP_ID", "0"), step, ("SLURM_PROCID", "3")];
        assert_eq!(of(&in_step), Some(4));
        let array = [job, ("SLURM_ARRAY_TASK_COUNT", "9"), ("SLURM_PROCID", "0")];
        assert_eq!(of(&array), None);
    }
}
