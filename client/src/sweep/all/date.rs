//! The day of a measurement, from the seconds that a clock counts.

/// Seconds of a day: UTC knows no others.
const DAY_SECS: u64 = 86_400;

/// Year, month and day in UTC, as `2026-11-22`, of seconds since 1970 began.
///
/// Years are taken to begin in March, so that the day that not every year has is the last: then months have 153 days
/// in five, and years 146,097 in four hundred (the Gregorian rule).
pub fn date_from_unix(secs: u64) -> String {
    // From the first of March of the year 0.
    let days = secs / DAY_SECS + 719_468;
    let (era, day_of_era) = (days / 146_097, days % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    let year = 400 * era + year_of_era + u64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}")
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The calendar, counted day by day.
    #[test]
    fn every_day_of_four_centuries_follows_the_one_before() {
        let (mut year, mut month, mut day) = (1970_u64, 1_u64, 1_u64);
        for number in 0..146_097 {
            assert_eq!(date_from_unix(number * DAY_SECS + number % DAY_SECS), format!("{year:04}-{month:02}-{day:02}"));
            let is_leap = year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400));
            let days = match month {
                2 => 28 + u64::from(is_leap),
                4 | 6 | 9 | 11 => 30,
                _ => 31,
            };
            day += 1;
            if day > days {
                (day, month) = (1, month + 1);
            }
            if month > 12 {
                (month, year) = (1, year + 1);
            }
        }
    }
}
