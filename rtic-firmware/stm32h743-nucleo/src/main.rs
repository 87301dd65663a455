//! A NUCLEO-H743ZI2 in the network: three UART links and USB, a Cortex-M7 at 384 MHz.
//!
//! | task        | bound to                    | priority | period / deadline   | shares             | worst cycles |
//! |-------------|-----------------------------|----------|---------------------|--------------------|--------------|
//! | `interpolate` | `TIM3`                    | 4        | 64 µs               | -                  | not measured |
//! | `link0`–`2` | `USART3`, `USART2`, `UART7` | 3        | receive FIFO, 53 µs | -                  | not measured |
//! | `wake`      | `TIM5`                      | 2        | packet TTL          | -                  |              |
//! | `usb`       | `OTG_FS`                    | 2        | bus, 1 ms           | links              |              |
//! | `route`     | `LPTIM1`, spare             | 2        | packet TTL; 100 ms  | node, links, alarm |              |
//! | `serve`     | `LPTIM2`, spare             | 1        | packet TTL          | node, alarm        |              |
//! | `idle`      | -                           | 0        | none                | node, settings     | -            |
//!
//! **Never run on hardware by its authors**, so that the last column stays empty: see `board_stm32h743_nucleo`.
//!
//! - **Walk:** a UART's interrupt fills its ring, and pends `route` when a frame has ended. `route` takes in all that came, answers the
//!   network, sends what can leave, and pends `serve` where a port has a packet. A frame that has left pends `route` again.
//! - **Invariants:** priority 4 is interpolation's, four axes, and shares nothing: nobody below delays an edge. Tasks share the node by RTIC's lock, whose ceiling is `route`: no link's
//!   interrupt ever waits for the node. `serve` holds it for single calls. Of the tasks at priority 2, `route` has a lower interrupt
//!   number than `usb`, and so runs before it where both wait: see `board_stm32h743_nucleo::usb`.
//! - **Context:** this file is the table; what a task does is in the board (interrupts) or in `firmware-app` (all else).
//! - **Clauses:** `[NOD-06]`, `[NOD-08]`, `[NOD-12]`, `[DSC-05]`, `[DSC-06]`.
#![no_std]
#![no_main]

#[cfg(not(feature = "node"))]
mod bare;
#[cfg(feature = "node")]
mod device;
mod handlers;
#[cfg(feature = "motion")]
mod interpolation;

#[cfg(feature = "node")]
#[rtic::app(device = board_stm32h743_nucleo::pac, peripherals = true)]
mod app {
    use crate::device::{Beats, Keeper, Links, NucleoNode, NucleoServices, ROUTE, Rings, Routing, SERVE, SharedNode};
    use board_stm32h743_nucleo::clock::{WakeInterrupt, now};
    use board_stm32h743_nucleo::uart::{UART_COUNT, UartBuffers, UartInterrupt};
    use firmware_app::lock::SharedMailbox;
    use fixed_math::time::LocalTicks;
    use rtic::pend;

    #[shared]
    struct Shared {
        node: NucleoNode,
        links: Links,
        /// When a service has something to do even if no packet comes.
        services_wake: Option<LocalTicks>,
    }

    #[local]
    struct Local {
        uart0: UartInterrupt,
        uart1: UartInterrupt,
        uart2: UartInterrupt,
        wake_interrupt: WakeInterrupt,
        beats: Beats,
        routing: Routing,
        services: NucleoServices,
        keeper: Keeper,
    }

    #[init(local = [
        buffers: [UartBuffers; UART_COUNT] = [const { UartBuffers::new() }; UART_COUNT],
        rings: Rings = Rings::new(),
    ])]
    fn init(cx: init::Context) -> (Shared, Local) {
        let parts = crate::device::start(cx.core, cx.device, cx.local.buffers, cx.local.rings);
        let [uart0, uart1, uart2] = parts.uart_interrupts;
        let crate::device::Parts { node, links, routing, beats, services, keeper, wake_interrupt, .. } = parts;
        pend(ROUTE);
        let local = Local { uart0, uart1, uart2, wake_interrupt, beats, routing, services, keeper };
        (Shared { node, links, services_wake: None }, local)
    }

    /// Keeps what the network changed and clocks learned, then sleeps: `route` wakes at least every 100 ms.
    #[idle(local = [keeper], shared = [node])]
    fn idle(mut cx: idle::Context) -> ! {
        loop {
            let changes = cx.shared.node.lock(crate::device::changes);
            cx.local.keeper.keep(&changes);
            cortex_m::asm::wfi();
        }
    }

    #[cfg(feature = "motion")]
    #[task(binds = TIM3, priority = 4, local = [beats])]
    fn interpolate(cx: interpolate::Context) {
        cx.local.beats.beat();
    }

    #[task(binds = USART3, priority = 3, local = [uart0])]
    fn link0(cx: link0::Context) {
        cx.local.uart0.on_interrupt().then(|| pend(ROUTE));
    }

    #[task(binds = USART2, priority = 3, local = [uart1])]
    fn link1(cx: link1::Context) {
        cx.local.uart1.on_interrupt().then(|| pend(ROUTE));
    }

    #[task(binds = UART7, priority = 3, local = [uart2])]
    fn link2(cx: link2::Context) {
        cx.local.uart2.on_interrupt().then(|| pend(ROUTE));
    }

    #[task(binds = TIM5, priority = 2, local = [wake_interrupt])]
    fn wake(cx: wake::Context) {
        cx.local.wake_interrupt.on_interrupt();
        pend(ROUTE);
    }

    #[cfg(feature = "usb")]
    #[task(binds = OTG_FS, priority = 2, shared = [links])]
    fn usb(mut cx: usb::Context) {
        cx.shared.links.lock(crate::device::poll_usb);
        pend(ROUTE);
    }

    #[task(binds = LPTIM1, priority = 2, shared = [node, links, services_wake], local = [routing])]
    fn route(cx: route::Context) {
        let mut shared = (cx.shared.node, cx.shared.links, cx.shared.services_wake);
        let serve = shared.lock(|node, links, at| cx.local.routing.run(node, links, *at));
        serve.then(|| pend(SERVE));
    }

    #[task(binds = LPTIM2, priority = 1, shared = [node, services_wake], local = [services])]
    fn serve(mut cx: serve::Context) {
        let mut mailbox = SharedMailbox(SharedNode(cx.shared.node));
        while cx.local.services.serve_next(&mut mailbox, now()) {}
        cx.shared.services_wake.lock(|at| *at = cx.local.services.next_wake());
        pend(ROUTE);
    }
}
