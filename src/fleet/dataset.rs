//! Properties shared by the logs of a dataset, determined from a few logs.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::sources::LogSource;
use crate::Options;
use crate::boundary::catch_panic;
use crate::log::{self, SourceName, enclosing_dataset, is_store, is_table, is_url, split_episode};
use crate::report::Trouble;
use crate::robot::catalogue;
pub use crate::run::SharedMapping;
use crate::run::{Run, identify_columns};

/// Indices of the logs of each dataset.
pub type Groups = BTreeMap<PathBuf, Vec<usize>>;

/// Smaller datasets are not sampled.
const MIN_DATASET_LOGS: usize = 4;
/// Logs sampled; up to twice as many if none is conclusive.
pub const SAMPLED_LOGS: usize = 3;

/// LeRobot folders, files with many episodes, and tables in one folder.
pub fn group_by_dataset(sources: &[LogSource]) -> Groups {
    let mut groups = Groups::new();
    for (at, source) in sources.iter().enumerate() {
        groups.entry(dataset_of(&source.path)).or_default().push(at);
    }
    groups.retain(|key, members| !key.as_os_str().is_empty() && members.len() >= MIN_DATASET_LOGS);
    groups
}

/// Empty if the log belongs to no dataset.
pub fn dataset_of(path: &Path) -> PathBuf {
    if is_url(path) {
        return PathBuf::new();
    }
    let (file, episode) = split_episode(path);
    let beside = || file.parent().filter(|_| is_table(&file)).map(Path::to_owned);
    match enclosing_dataset(&file) {
        Some(folder) => folder,
        None if episode.is_some() => file,
        None => beside().unwrap_or_default(),
    }
}

/// Sample spread over all logs, in the order of inspection.
pub fn sample_logs(members: &[usize]) -> Vec<usize> {
    let at = |share: f64| members[((members.len() - 1) as f64 * share) as usize];
    let mut asked: Vec<usize> = Vec::new();
    for share in [0.0, 0.5, 1.0, 0.25, 0.75, 0.125] {
        if !asked.contains(&at(share)) {
            asked.push(at(share));
        }
    }
    asked
}

pub fn infer_shared(path: &Path, options: &Options) -> Option<SharedMapping> {
    let options = Options { logs: vec![path.to_owned()], ..options.clone() };
    let from = SourceName::from_path(path).to_string();
    let from = from.rsplit('/').next().unwrap_or_default().to_owned();
    let learn = || -> Result<SharedMapping, Trouble> {
        let mut log = log::open(&options.logs, &options.read)?;
        let mut columns = identify_columns(&mut log, &options.run);
        if let Some(columns) = &mut columns {
            columns.from.clone_from(&from);
        }
        let run = Run::complete(log, &options.run, |_| Ok::<_, Trouble>(()));
        let robot = run.ok().and_then(|run| match run.arms.as_slice() {
            [only] if options.run.robots.is_empty() => Some(only.robot.name.clone()),
            _ => None,
        });
        let robot = robot.filter(|name| catalogue::find(name).is_some());
        Ok(SharedMapping { from: vec![from], robot, columns })
    };
    catch_panic(learn).ok()?.ok()
}

/// The arm if all agree, and the columns if all conclusive logs agree.
pub fn merge_shared(mappings: Vec<SharedMapping>, group: &Path) -> Option<SharedMapping> {
    let first = mappings.first()?;
    // Tables in one folder may belong to several arms.
    let is_one =
        enclosing_dataset(&group.join("meta")).is_some() || group.is_file() || is_store(group);
    let robot = first.robot.clone();
    let robot = robot.filter(|_| is_one && mappings.iter().all(|it| it.robot == first.robot));
    let decided: Vec<_> = mappings
        .iter()
        .filter_map(|it| it.columns.as_ref().filter(|columns| columns.is_determined()))
        .collect();
    let columns = match decided.as_slice() {
        [] => first.columns.clone().filter(|_| mappings.iter().all(|it| it.columns.is_some())),
        [columns, others @ ..] => {
            others.iter().all(|other| columns.agrees(other)).then(|| (*columns).clone())
        }
    };
    let from = mappings.iter().flat_map(|it| it.from.clone()).collect();
    Some(SharedMapping { from, robot, columns })
        .filter(|it| it.robot.is_some() || it.columns.is_some())
}

/// Whether the columns are undetermined and another log may help.
pub fn is_undetermined(mappings: &[SharedMapping]) -> bool {
    let has_determined_columns =
        |it: &SharedMapping| it.columns.as_ref().is_some_and(|columns| columns.is_determined());
    mappings.iter().any(|it| it.columns.is_some()) && !mappings.iter().any(has_determined_columns)
}
