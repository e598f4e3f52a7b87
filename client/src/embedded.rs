//! The server inside the client: same code, loopback TCP, threads of its own. What else of the client knows the
//! server's crate is the virtual clock, which drives its sessions, and the commands that make a scene ready.

use std::io;
use std::net::{Ipv4Addr, SocketAddr};
use warplight_server::net;
use warplight_server::service::Service;

/// Starts a server on a free loopback port; it ends with the process.
pub fn start(service: Service) -> io::Result<SocketAddr> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let listener = runtime.block_on(net::listen((Ipv4Addr::LOCALHOST, 0).into()))?;
    let address = listener.local_addr()?;
    std::thread::Builder::new()
        .name("server".to_owned())
        .spawn(move || runtime.block_on(net::serve(listener, service)))?;
    Ok(address)
}
