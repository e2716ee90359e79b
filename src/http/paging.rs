//! Long lists in pages: `?after=` where the page before ended, `?limit=` how many; `Link: rel="next"` leads on. Pure.

use super::problem::Problem;
use axum::Json;
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::IntoParams;

/// Entries of a page if nobody says how many.
pub(super) const USUAL: usize = 500;
/// Entries of a page at most.
const MOST: usize = 1000;

/// Which page.
#[derive(Clone, Copy, Default, Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct PageOrder {
    /// Number of the entry after which the page begins; from the beginning without it.
    #[param(example = 0)]
    after: Option<u64>,
    /// How many entries at most; 500 if left out.
    #[param(minimum = 1, maximum = 1000, example = 100)]
    limit: Option<usize>,
}

/// A page of entries, each known by its number.
pub(super) struct Page<T> {
    entries: Vec<T>,
    /// Where the next page is, if there is one.
    next: Option<String>,
}

impl PageOrder {
    /// The page out of all entries in the order of the list, which `number` tells apart. `at` is where the list is
    /// asked for. An entry that is gone meanwhile is passed by as `beyond` says: whether the number of an entry lies
    /// behind another's in the list.
    pub(super) fn of<T>(
        self,
        all: impl IntoIterator<Item = T>,
        number: impl Fn(&T) -> u64,
        beyond: impl Fn(u64, u64) -> bool,
        at: &str,
    ) -> Result<Page<T>, Problem> {
        let limit = self.limit.unwrap_or(USUAL);
        if !(1..=MOST).contains(&limit) {
            let words = format!("limit is {limit}, but a page has 1 to {MOST} entries");
            return Err(Problem::bad_request("value_invalid", words));
        }
        let due = |entry: &T| self.after.is_none_or(|after| beyond(number(entry), after));
        let mut rest = all.into_iter().filter(due);
        let entries: Vec<T> = rest.by_ref().take(limit).collect();
        let last = entries.last().map(&number);
        let next = last.filter(|_| rest.next().is_some());
        Ok(Page { entries, next: next.map(|last| format!("{at}?after={last}&limit={limit}")) })
    }
}

impl<T> Page<T> {
    pub(super) fn map<U>(self, change: impl FnMut(T) -> U) -> Page<U> {
        Page { entries: self.entries.into_iter().map(change).collect(), next: self.next }
    }
}

impl<T: Serialize> IntoResponse for Page<T> {
    fn into_response(self) -> Response {
        let link = self.next.and_then(|next| HeaderValue::try_from(format!("<{next}>; rel=\"next\"")).ok());
        let mut response = Json(self.entries).into_response();
        if let Some(link) = link {
            response.headers_mut().insert(header::LINK, link);
        }
        response
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn page(after: Option<u64>, limit: Option<usize>) -> Result<(Vec<u64>, Option<String>), Problem> {
        let order = PageOrder { after, limit };
        order.of([1, 2, 4, 7], |n| *n, |n, after| n > after, "/x").map(|page| (page.entries, page.next))
    }

    #[test]
    fn pages_follow_each_other_without_gap_or_overlap() {
        assert_eq!(page(None, None).unwrap(), (vec![1, 2, 4, 7], None));
        let (first, next) = page(None, Some(2)).unwrap();
        assert_eq!((first, next.as_deref()), (vec![1, 2], Some("/x?after=2&limit=2")));
        assert_eq!(page(Some(2), Some(2)).unwrap(), (vec![4, 7], None));
        assert_eq!(
            page(Some(3), Some(1)).unwrap(),
            (vec![4], Some("/x?after=4&limit=1".into())),
            "3 is gone"
        );
        assert_eq!(page(Some(7), None).unwrap(), (vec![], None));
    }

    #[test]
    fn a_page_of_nothing_or_of_too_much_is_refused() {
        assert!(page(None, Some(0)).is_err() && page(None, Some(1001)).is_err());
        assert!(page(None, Some(1000)).is_ok());
    }
}
