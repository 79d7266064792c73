from services.scheduler.app import main

raise SystemExit(main())
