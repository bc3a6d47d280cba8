use polars::prelude::{DataFrame, PolarsResult};
use serde_json::Value;

pub(super) struct TablePart<'a>(pub(super) &'a DataFrame);

impl TablePart<'_> {
    pub(super) fn text(&self, name: &str, row: usize) -> PolarsResult<Option<String>> {
        Ok(self.0.column(name)?.str()?.get(row).map(str::to_owned))
    }

    pub(super) fn number(&self, name: &str, row: usize) -> PolarsResult<Option<f64>> {
        Ok(self.0.column(name)?.f64()?.get(row).filter(|number| number.is_finite()))
    }

    pub(super) fn stamp(&self, name: &str, row: usize) -> PolarsResult<Option<i64>> {
        Ok(self.0.column(name)?.i64()?.get(row))
    }

    pub(super) fn estimate_name(&self, row: usize) -> PolarsResult<String> {
        let text = self.text("estimate_json", row)?;
        let estimate: Option<Value> = text.and_then(|text| serde_json::from_str(&text).ok());
        let name = estimate.as_ref().and_then(|estimate| estimate.get("name")?.as_str());
        Ok(name.unwrap_or_default().to_owned())
    }
}
