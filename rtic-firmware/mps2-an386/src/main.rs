//! The image for QEMU's `mps2-an386`: five UARTs, a node, services.
//!
//! | task                  | bound to     | priority | period / deadline     | shares                | worst cycles |
//! |-----------------------|--------------|----------|-----------------------|-----------------------|--------------|
//! | `interpolate`         | `SysTick`    | 4        | 64 µs                 | -                     | not modelled |
//! | `wake`                | TIMER1       | 3        | set by `route`        | -                     | not modelled |
//! | `link0_rx`–`link4_rx` | `UARTnRX`    | 3        | 6.4 µs: the next byte | receive rings         | not modelled |
//! | `link0_tx`–`link4_tx` | `UARTnTX`    | 3        | none: the wire idles  | frame buffers         | not modelled |
//! | `route`               | PORT0, spare | 2        | packet TTL; 100 ms    | node, services' alarm | not modelled |
//! | `serve`               | PORT1, spare | 1        | packet TTL            | node, services' alarm | not modelled |
//! | `idle`                | -            | 0        | none                  | node, settings        | -            |
//!
//! It has everything, always: no features to leave out. Walk, invariants, context and clauses are those of the image `mps2-an500`.
#![no_std]
#![no_main]

mod device;
mod handlers;
mod interpolation;

#[rtic::app(device = board_mps2_an386::pac, peripherals = true)]
mod app {
    use crate::device::{Links, Locked, Node, ROUTE, SERVE, Services, Settings, start};
    use crate::interpolation::{Beats, Rings};
    use board_mps2_an386::clock::{Wake, WakeInterrupt, keep, now};
    use board_mps2_an386::uart::{UART_COUNT, UartBuffers};
    use board_mps2_an386::watchdog::Watchdog;
    use board_mps2_an386::{UartRx, UartTx};
    use firmware_app::lock::SharedMailbox;
    use firmware_app::routing::route as route_once;
    use fixed_math::time::LocalTicks;
    use rtic::pend;

    #[shared]
    struct Shared {
        node: Node,
        /// When a service has something to do even if no packet comes.
        services_wake: Option<LocalTicks>,
    }

    #[local]
    struct Local {
        rx0: UartRx,
        rx1: UartRx,
        rx2: UartRx,
        rx3: UartRx,
        rx4: UartRx,
        tx0: UartTx,
        tx1: UartTx,
        tx2: UartTx,
        tx3: UartTx,
        tx4: UartTx,
        beats: Beats,
        links: Links,
        services: Services,
        wake: Wake,
        wake_interrupt: WakeInterrupt,
        watchdog: Watchdog,
        settings: Option<Settings>,
    }

    #[init(local = [
        uart_buffers: [UartBuffers; UART_COUNT] = [const { UartBuffers::new() }; UART_COUNT],
        rings: Rings = Rings::new(),
    ])]
    fn init(cx: init::Context) -> (Shared, Local) {
        let device = start(cx.device, cx.local.uart_buffers, cx.local.rings);
        let [rx0, rx1, rx2, rx3, rx4] = device.rx;
        let [tx0, tx1, tx2, tx3, tx4] = device.tx;
        let (wake, wake_interrupt) = device.wake.split();
        let local = Local {
            rx0,
            rx1,
            rx2,
            rx3,
            rx4,
            tx0,
            tx1,
            tx2,
            tx3,
            tx4,
            beats: device.beats,
            links: device.links,
            services: device.services,
            wake,
            wake_interrupt,
            watchdog: device.watchdog,
            settings: device.settings,
        };
        pend(ROUTE);
        (Shared { node: device.node, services_wake: None }, local)
    }

    /// Keeps names given over the network, then sleeps: `route` wakes at least every 100 ms.
    #[idle(shared = [node], local = [settings])]
    fn idle(mut cx: idle::Context) -> ! {
        loop {
            let name = cx.shared.node.lock(crate::device::new_name);
            // the node has the new name in any case
            let _until_power_off =
                cx.local.settings.as_mut().zip(name).map(|(settings, name)| settings.set_name(&name));
            cortex_m::asm::wfi();
        }
    }

    #[task(binds = PORT1, priority = 1, shared = [node, services_wake], local = [services])]
    fn serve(mut cx: serve::Context) {
        let mut mailbox = SharedMailbox(Locked(cx.shared.node));
        while cx.local.services.serve_next(&mut mailbox, now()) {}
        cx.shared.services_wake.lock(|at| *at = cx.local.services.next_wake());
        pend(ROUTE);
    }

    #[task(binds = PORT0, priority = 2, shared = [node, services_wake], local = [links, wake, watchdog])]
    fn route(mut cx: route::Context) {
        let services_wake = cx.shared.services_wake.lock(|at| *at);
        let next = cx.shared.node.lock(|node| route_once(node, cx.local.links, services_wake, now()));
        next.serve.then(|| pend(SERVE));
        cx.local.wake.set(next.wake, now());
        keep();
        cx.local.watchdog.feed();
    }

    #[task(binds = TIMER1, priority = 3, local = [wake_interrupt])]
    fn wake(cx: wake::Context) {
        cx.local.wake_interrupt.on_interrupt();
        pend(ROUTE);
    }

    #[task(binds = SysTick, priority = 4, local = [beats])]
    fn interpolate(cx: interpolate::Context) {
        cx.local.beats.beat();
    }

    #[task(binds = UART0RX, priority = 3, local = [rx0])]
    fn link0_rx(cx: link0_rx::Context) {
        cx.local.rx0.on_interrupt().then(|| pend(ROUTE));
    }

    #[task(binds = UART0TX, priority = 3, local = [tx0])]
    fn link0_tx(cx: link0_tx::Context) {
        cx.local.tx0.on_interrupt().then(|| pend(ROUTE));
    }

    #[task(binds = UART1RX, priority = 3, local = [rx1])]
    fn link1_rx(cx: link1_rx::Context) {
        cx.local.rx1.on_interrupt().then(|| pend(ROUTE));
    }

    #[task(binds = UART1TX, priority = 3, local = [tx1])]
    fn link1_tx(cx: link1_tx::Context) {
        cx.local.tx1.on_interrupt().then(|| pend(ROUTE));
    }

    #[task(binds = UART2RX, priority = 3, local = [rx2])]
    fn link2_rx(cx: link2_rx::Context) {
        cx.local.rx2.on_interrupt().then(|| pend(ROUTE));
    }

    #[task(binds = UART2TX, priority = 3, local = [tx2])]
    fn link2_tx(cx: link2_tx::Context) {
        cx.local.tx2.on_interrupt().then(|| pend(ROUTE));
    }

    #[task(binds = UART3RX, priority = 3, local = [rx3])]
    fn link3_rx(cx: link3_rx::Context) {
        cx.local.rx3.on_interrupt().then(|| pend(ROUTE));
    }

    #[task(binds = UART3TX, priority = 3, local = [tx3])]
    fn link3_tx(cx: link3_tx::Context) {
        cx.local.tx3.on_interrupt().then(|| pend(ROUTE));
    }

    #[task(binds = UART4RX, priority = 3, local = [rx4])]
    fn link4_rx(cx: link4_rx::Context) {
        cx.local.rx4.on_interrupt().then(|| pend(ROUTE));
    }

    #[task(binds = UART4TX, priority = 3, local = [tx4])]
    fn link4_tx(cx: link4_tx::Context) {
        cx.local.tx4.on_interrupt().then(|| pend(ROUTE));
    }
}
