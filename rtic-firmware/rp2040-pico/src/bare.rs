//! The image without a network, to measure what the network takes: clocks, UARTs, DMA, and the tasks that serve them.

#[rtic::app(device = board_rp2040_pico::pac, peripherals = true)]
mod app {
    use board_rp2040_pico::uart::{self, DmaUart};
    use board_rp2040_pico::{Board, clock};
    use firmware_app::Wire;

    #[shared]
    struct Shared {}

    #[local]
    struct Local {
        uarts: [DmaUart; 2],
    }

    #[init]
    fn init(cx: init::Context) -> (Shared, Local) {
        let board = Board::init(cx.device, false);
        (Shared {}, Local { uarts: board.uarts })
    }

    #[task(binds = DMA_IRQ_0, priority = 3)]
    fn receive(_: receive::Context) {
        if uart::receive() {
            rtic::pend(board_rp2040_pico::pac::Interrupt::SW0_IRQ);
        }
    }

    /// Sends back what came.
    #[task(binds = SW0_IRQ, priority = 2, local = [uarts])]
    fn route(cx: route::Context) {
        for uart in cx.local.uarts {
            let now = clock::now();
            let mut len = 0;
            let mut copy = [0; 256];
            uart.drain(now, |run, _| {
                let fits = run.len().min(copy.len() - len);
                copy[len..len + fits].copy_from_slice(&run[..fits]);
                len += fits;
            });
            if let Some(at) = uart.clear_at(now) {
                uart.room()[..len].copy_from_slice(&copy[..len]);
                uart.send(len, at);
            }
        }
    }
}
