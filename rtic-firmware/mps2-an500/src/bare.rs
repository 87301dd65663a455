//! The image without a node: what the hardware, RTIC and the interrupts cost by themselves, for `cargo xtask size` to compare with.
//!
//! - **Walk:** receive interrupt → ring → `echo` → the same bytes on the same UART.
//! - **Invariant:** the interrupts are those of the whole image.
//! - **Context:** as the whole image's, with `echo` in place of `route`.

use board_mps2_an500::pac::Interrupt;

/// What `echo` is bound to: a port's interrupt that nothing else uses.
const ECHO: Interrupt = Interrupt::PORT0;

#[rtic::app(device = board_mps2_an500::pac, peripherals = true)]
mod app {
    use super::ECHO;
    use board_mps2_an500::uart::{UART_COUNT, UartBuffers};
    use board_mps2_an500::{Board, REGION, Uart, UartRx, UartTx, now};
    use firmware_app::Wire;
    use rtic::pend;

    #[shared]
    struct Shared {}

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
        wires: [Uart; UART_COUNT],
    }

    #[init(local = [uart_buffers: [UartBuffers; UART_COUNT] = [const { UartBuffers::new() }; UART_COUNT]])]
    fn init(cx: init::Context) -> (Shared, Local) {
        let board = Board::new(cx.device, REGION, cx.local.uart_buffers);
        let [rx0, rx1, rx2, rx3, rx4] = board.rx;
        let [tx0, tx1, tx2, tx3, tx4] = board.tx;
        let wires = board.wires;
        (Shared {}, Local { rx0, rx1, rx2, rx3, rx4, tx0, tx1, tx2, tx3, tx4, wires })
    }

    /// Sends back what has come; what finds the buffer full or on its way is lost.
    #[task(binds = PORT0, priority = 2, local = [wires])]
    fn echo(cx: echo::Context) {
        for wire in cx.local.wires {
            let now = now();
            let mut bytes = [0; 256];
            let mut len = 0;
            wire.drain(now, |run, _| {
                let run = &run[..run.len().min(bytes.len() - len)];
                bytes[len..len + run.len()].copy_from_slice(run);
                len += run.len();
            });
            if len > 0
                && let Some(at) = wire.clear_at(now)
            {
                wire.room()[..len].copy_from_slice(&bytes[..len]);
                wire.send(len, at);
            }
        }
    }

    #[task(binds = UART0RX, priority = 3, local = [rx0])]
    fn link0_rx(cx: link0_rx::Context) {
        cx.local.rx0.on_interrupt().then(|| pend(ECHO));
    }

    #[task(binds = UART0TX, priority = 3, local = [tx0])]
    fn link0_tx(cx: link0_tx::Context) {
        cx.local.tx0.on_interrupt().then(|| pend(ECHO));
    }

    #[task(binds = UART1RX, priority = 3, local = [rx1])]
    fn link1_rx(cx: link1_rx::Context) {
        cx.local.rx1.on_interrupt().then(|| pend(ECHO));
    }

    #[task(binds = UART1TX, priority = 3, local = [tx1])]
    fn link1_tx(cx: link1_tx::Context) {
        cx.local.tx1.on_interrupt().then(|| pend(ECHO));
    }

    #[task(binds = UART2RX, priority = 3, local = [rx2])]
    fn link2_rx(cx: link2_rx::Context) {
        cx.local.rx2.on_interrupt().then(|| pend(ECHO));
    }

    #[task(binds = UART2TX, priority = 3, local = [tx2])]
    fn link2_tx(cx: link2_tx::Context) {
        cx.local.tx2.on_interrupt().then(|| pend(ECHO));
    }

    #[task(binds = UART3RX, priority = 3, local = [rx3])]
    fn link3_rx(cx: link3_rx::Context) {
        cx.local.rx3.on_interrupt().then(|| pend(ECHO));
    }

    #[task(binds = UART3TX, priority = 3, local = [tx3])]
    fn link3_tx(cx: link3_tx::Context) {
        cx.local.tx3.on_interrupt().then(|| pend(ECHO));
    }

    #[task(binds = UART4RX, priority = 3, local = [rx4])]
    fn link4_rx(cx: link4_rx::Context) {
        cx.local.rx4.on_interrupt().then(|| pend(ECHO));
    }

    #[task(binds = UART4TX, priority = 3, local = [tx4])]
    fn link4_tx(cx: link4_tx::Context) {
        cx.local.tx4.on_interrupt().then(|| pend(ECHO));
    }
}
