//! What a session refuses, by name, and what it says nothing of.

use super::*;

/// The one error that a session says last, and the end.
fn refused(session: &mut ServerSession, now: Timestamp) -> (ErrorCode, String) {
    let said = heard(session, now);
    let Some(Message::Error { code, text }) = said.last() else { panic!("{said:?}") };
    assert!(session.end().is_some() && session.poll_render(now).is_none());
    (*code, text.clone())
}

#[test]
fn a_token_is_asked_for_before_anything_else_and_never_repeated() {
    let token = Token::new("correct-horse-battery").unwrap();
    let mut known = ServerSession::new(SessionConfig { token: token.clone(), ..config() }, at(0));
    say(&mut known, at(0), Message::Hello(Hello { token: token.clone(), ..hello() }));
    assert!(known.is_open() && matches!(&heard(&mut known, at(0))[..], [Message::Welcome(_)]));
    assert!(!format!("{known:?}").contains("horse"));

    for (wrong, says) in [(Token::NONE, "wants a token"), (Token::new("correct-horse-batter!").unwrap(), "not this")] {
        let mut session = ServerSession::new(SessionConfig { token: token.clone(), ..config() }, at(0));
        // A camera beyond the limits, of which who is not known learns nothing.
        let camera = Camera::symmetric(1.0, ImageSize::new(8192, 8192));
        say(&mut session, at(0), Message::Hello(Hello { token: wrong, camera, ..hello() }));
        let (code, text) = refused(&mut session, at(0));
        assert!(code == ErrorCode::Unauthorised && text.contains(says) && !text.contains("horse"), "{text}");
        assert!(!format!("{:?}", session.end()).contains("horse"));
    }
}

#[test]
fn a_second_hello_is_refused() {
    let mut session = ServerSession::new(config(), at(0));
    say(&mut session, at(0), Message::Hello(hello()));
    say(&mut session, at(1), Message::Hello(hello()));
    let (code, text) = refused(&mut session, at(1));
    assert!(code == ErrorCode::Protocol && text.contains("one hello"), "{text}");
}

#[test]
fn a_hello_that_dribbles_is_waited_for_no_longer_than_five_seconds() {
    let mut session = ServerSession::new(config(), at(0));
    let mut bytes = Vec::new();
    write_message(&Message::Hello(hello()), &mut bytes);
    for (second, byte) in bytes.iter().enumerate().take(5) {
        assert!(session.end().is_none());
        session.on_bytes(at(second as u64 * 1000), &[*byte]);
        session.on_timeout(at(second as u64 * 1000 + 999));
    }
    assert_eq!(session.next_timeout(), at(5000));
    session.on_timeout(at(5000));
    assert_eq!(session.end(), Some(&SessionEnd::NoHello));
    assert!(refused(&mut session, at(5000)).1.contains("within 5 s"));
}

#[test]
fn time_spent_on_tls_is_taken_from_that_of_the_hello() {
    let mut session = ServerSession::new(config(), at(4000));
    session.connected_at(at(0));
    session.on_timeout(at(4999));
    assert!(session.end().is_none());
    session.on_timeout(at(5000));
    assert_eq!(session.end(), Some(&SessionEnd::NoHello));
}

#[test]
fn more_poses_than_any_display_has_are_refused_by_name() {
    let mut session = ServerSession::new(config(), at(0));
    say(&mut session, at(0), Message::Hello(hello()));
    let sample = PoseSample { time: at(1), pose: Pose::IDENTITY };
    let batches = (0..100).take_while(|_| {
        say(&mut session, at(1), Message::Poses(vec![sample; 250]));
        session.end().is_none()
    });
    assert_eq!(batches.count(), 2 * MAX_POSES_PER_SEC as usize / 250);
    let (code, text) = refused(&mut session, at(1));
    assert!(code == ErrorCode::Limit && text.contains("2000 poses per second"), "{text}");
}

#[test]
fn pings_whose_answers_nobody_reads_do_not_pile_up() {
    let mut session = ServerSession::new(config(), at(0));
    say(&mut session, at(0), Message::Hello(hello()));
    for _ in 0..2000 {
        say(&mut session, at(1), Message::Ping(at(1)));
    }
    assert_eq!(session.end(), Some(&SessionEnd::Unread));
    assert!(heard(&mut session, at(1)).len() <= 2, "what waited is discarded with the session");
}

#[test]
fn a_client_that_answers_no_ping_is_let_go_and_one_that_does_is_not() {
    for answers in [true, false] {
        let mut session = ServerSession::new(config(), at(0));
        say(&mut session, at(0), Message::Hello(hello()));
        for step in 1..200 {
            let now = at(step * 100);
            pose(&mut session, now);
            for message in heard(&mut session, now) {
                if let (true, Message::Ping(time)) = (answers, message) {
                    say(&mut session, now, Message::Pong(time));
                }
            }
            session.on_timeout(now);
        }
        assert_eq!(session.end(), if answers { None } else { Some(&SessionEnd::Unread) });
    }
}

#[test]
fn a_client_has_nothing_long_to_say() {
    let mut session = ServerSession::new(config(), at(0));
    // The head of a strip of 1 MB: allowed from a server, refused before a byte of it has come.
    session.on_bytes(at(0), &[0, 0, 16, 0, 5]);
    assert_eq!(refused(&mut session, at(0)).0, ErrorCode::Limit);
}

#[test]
fn a_server_that_stops_says_goodbye_and_one_that_is_full_says_so() {
    let mut session = ServerSession::new(config(), at(0));
    say(&mut session, at(0), Message::Hello(hello()));
    session.close(SessionEnd::Stopping);
    session.close(SessionEnd::Busy(8));
    assert_eq!(heard(&mut session, at(0)), [Message::Bye], "instead of the welcome; the first end counts");

    let mut session = ServerSession::new(config(), at(0));
    say(&mut session, at(0), Message::Hello(hello()));
    session.close(SessionEnd::Busy(8));
    let (code, text) = refused(&mut session, at(0));
    assert!(code == ErrorCode::Busy && text.contains("8 sessions"), "{text}");
}
