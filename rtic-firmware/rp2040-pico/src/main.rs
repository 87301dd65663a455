//! A Raspberry Pi Pico in the network: two UART links and USB, an RP2040 at 125 MHz, all code in RAM.
//!
//! | task        | bound to       | priority | every µs | deadline µs | shares      | worst cycles (measured) | lock cycles |
//! |-------------|----------------|----------|----------|-------------|-------------|-------------------------|-------------|
//! | interpolate | `PWM_IRQ_WRAP` | 4        | 64       | 64          | -           | 450                     | -           |
//! | receive     | `DMA_IRQ_0`    | 3        | 300      | 1,706       | -           | 6,340                   | -           |
//! | transmitted | `DMA_IRQ_1`    | 2        | 435      | -           | -           | 55                      | -           |
//! | wake        | `TIMER_IRQ_0`  | 2        | 300      | -           | -           | 60                      | -           |
//! | usb         | `USBCTRL_IRQ`  | 2        | 1,000    | -           | links       | 1,020                   | -           |
//! | route       | `SW0_IRQ`      | 2        | 435      | 853         | node, links | 60,000                  | -           |
//! | serve       | `SW1_IRQ`      | 1        | -        | -           | node        | -                       | 420         |
//! | idle        | -              | 0        | -        | -           | node        | -                       | 420         |
//!
//! Priority 4 is interpolation's: four axes, of which nobody below can delay an edge (`interpolation`). Its row is that of a hub, whose beat has nothing
//! to play: what forwards at full load. **A motor's beat takes 3,240 cycles in the mean with four axes that move, and 7,020 at most, where all of them starve at a knot
//! (`hil motion`), which is within its 64 µs; by this analysis such a motor cannot also forward at full load on both wires.**
//! Bytes and their stamps are moved by DMA, so that no priority is urgent for them. The node is
//! held by `serve` for single calls; a service works without it.
//!
//! `cargo xtask hil cycles` measures, `cargo xtask hil rta` calculates response times from this table; the cycles are the most seen, and a tenth
//! more. Both UARTs at full load: `receive` is counted as a burst, for each UART 8 interrupts until routing is woken, one a byte, and one more for a
//! byte that came while its interrupt was off, 350 cycles each: one that interpolation kept waiting, and that finds more than one byte, so that there
//! are fewer of them than counted here. Then the UART is silent until a turn of `route` has drained it, once a turn: in the response time of `route`
//! (its own turn, one before it, and what was left of an earlier burst) lie three bursts at most, which is what `every` comes to. A turn of `route`
//! takes in all that came, so its worst is that of many frames and of exchanges of time at both links, which come 200 times a second at most. A
//! ring holds 1,706 µs of bytes, and two turns may lie between a byte and its drain: each has half of that. A lock is no longer than `route` was
//! ever seen to be pending. Where `transmitted` is late a wire idles, where `usb` is the host waits, and `serve` has what is left; they have no
//! deadline.
#![no_std]
#![no_main]

#[cfg(not(feature = "node"))]
mod bare;
#[cfg(feature = "node")]
mod device;
#[cfg(feature = "evaluate")]
mod evaluations;
#[cfg(feature = "report")]
mod handlers;
#[cfg(feature = "motion")]
mod interpolation;

#[cfg(not(feature = "report"))]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    cortex_m::peripheral::SCB::sys_reset()
}

#[cfg(feature = "node")]
#[rtic::app(device = board_rp2040_pico::pac, peripherals = true)]
mod app {
    #[cfg(feature = "services")]
    use crate::device::SharedNode;
    use crate::device::{
        Keeper, PicoBeats, PicoLinks, PicoNode, PicoServices, Places, ROUTE, Routing, SERVE, wake_routing,
    };
    use board_rp2040_pico::clock::Alarm;
    use board_rp2040_pico::uart;
    use fixed_math::time::LocalTicks;

    #[shared]
    struct Shared {
        node: &'static mut PicoNode,
        /// Of tasks of one priority, so without a lock, which masks interrupts one by one.
        #[lock_free]
        links: PicoLinks,
        /// When a service has something to send.
        due: Option<LocalTicks>,
    }

    #[local]
    struct Local {
        routing: Routing,
        services: &'static mut PicoServices,
        keeper: Keeper,
        beats: PicoBeats,
    }

    #[init(local = [places: Places = Places::new()])]
    fn init(cx: init::Context) -> (Shared, Local) {
        let crate::device::Parts { node, links, routing, services, keeper, beats } =
            crate::device::start(cx.device, cx.local.places);
        wake_routing();
        let local = Local { routing, services, keeper, beats };
        (Shared { node, links, due: None }, local)
    }

    #[idle(local = [keeper], shared = [node])]
    fn idle(mut cx: idle::Context) -> ! {
        loop {
            let changes = cx.shared.node.lock(|node| crate::device::changes(node));
            cx.local.keeper.keep(&changes);
            cortex_m::asm::wfi();
        }
    }

    #[cfg(feature = "motion")]
    #[task(binds = PWM_IRQ_WRAP, priority = 4, local = [beats])]
    fn interpolate(cx: interpolate::Context) {
        cx.local.beats.beat();
    }

    #[task(binds = DMA_IRQ_0, priority = 3)]
    fn receive(_: receive::Context) {
        if uart::receive() {
            rtic::pend(ROUTE);
        }
    }

    #[task(binds = DMA_IRQ_1, priority = 2)]
    fn transmitted(_: transmitted::Context) {
        uart::clear_transmitted();
        wake_routing();
    }

    #[task(binds = TIMER_IRQ_0, priority = 2)]
    fn wake(_: wake::Context) {
        Alarm::clear();
        wake_routing();
    }

    #[task(binds = USBCTRL_IRQ, priority = 2, shared = [links])]
    fn usb(cx: usb::Context) {
        cx.shared.links.poll_usb();
        wake_routing();
    }

    #[task(binds = SW0_IRQ, priority = 2, shared = [node, links, due], local = [routing])]
    fn route(cx: route::Context) {
        let routing = cx.local.routing;
        let links = cx.shared.links;
        let serve = (cx.shared.node, cx.shared.due).lock(|node, due| routing.turn(node, links, *due));
        if serve {
            rtic::pend(SERVE);
        }
    }

    #[cfg(feature = "services")]
    #[task(binds = SW1_IRQ, priority = 1, shared = [node, due], local = [services])]
    fn serve(mut cx: serve::Context) {
        let mut mailbox = firmware_app::lock::SharedMailbox(SharedNode(cx.shared.node));
        while cx.local.services.serve_next(&mut mailbox, board_rp2040_pico::clock::now()) {}
        let next = cx.local.services.next_wake();
        cx.shared.due.lock(|due| *due = next);
        wake_routing();
    }
}
