from services.robot_agent.app import main

raise SystemExit(main())
