//! The image without a network, to measure what the network takes: clocks, caches, UARTs, and the tasks that serve them.
//!
//! - **Walk:** a UART's interrupt → ring → `echo` → the same bytes on the same UART.
//! - **Invariant:** the interrupts are those of the whole image.
//! - **Context:** as the whole image's, with `echo` in place of `route`.

#[rtic::app(device = board_stm32h743_nucleo::pac, peripherals = true)]
mod app {
    use board_stm32h743_nucleo::Board;
    use board_stm32h743_nucleo::clock::now;
    use board_stm32h743_nucleo::pac::Interrupt;
    use board_stm32h743_nucleo::uart::{UART_COUNT, Uart, UartBuffers, UartInterrupt};
    use firmware_app::Wire;
    use rtic::pend;

    /// What `echo` is bound to.
    const ECHO: Interrupt = Interrupt::LPTIM1;

    #[shared]
    struct Shared {}

    #[local]
    struct Local {
        uart0: UartInterrupt,
        uart1: UartInterrupt,
        uart2: UartInterrupt,
        uarts: [Uart; UART_COUNT],
    }

    #[init(local = [buffers: [UartBuffers; UART_COUNT] = [const { UartBuffers::new() }; UART_COUNT]])]
    fn init(cx: init::Context) -> (Shared, Local) {
        let board = Board::init(cx.core, cx.device, cx.local.buffers, false);
        let [uart0, uart1, uart2] = board.uart_interrupts;
        (Shared {}, Local { uart0, uart1, uart2, uarts: board.uarts })
    }

    /// Sends back what has come; what finds the buffer full or on its way is lost.
    #[task(binds = LPTIM1, priority = 2, local = [uarts])]
    fn echo(cx: echo::Context) {
        for uart in cx.local.uarts {
            let mut bytes = [0; 256];
            let mut len = 0;
            uart.drain(now(), |run, _| {
                let run = &run[..run.len().min(bytes.len() - len)];
                bytes[len..len + run.len()].copy_from_slice(run);
                len += run.len();
            });
            if len > 0
                && let Some(at) = uart.clear_at(now())
            {
                uart.room()[..len].copy_from_slice(&bytes[..len]);
                uart.send(len, at);
            }
        }
    }

    #[task(binds = USART3, priority = 3, local = [uart0])]
    fn link0(cx: link0::Context) {
        cx.local.uart0.on_interrupt().then(|| pend(ECHO));
    }

    #[task(binds = USART2, priority = 3, local = [uart1])]
    fn link1(cx: link1::Context) {
        cx.local.uart1.on_interrupt().then(|| pend(ECHO));
    }

    #[task(binds = UART7, priority = 3, local = [uart2])]
    fn link2(cx: link2::Context) {
        cx.local.uart2.on_interrupt().then(|| pend(ECHO));
    }
}
